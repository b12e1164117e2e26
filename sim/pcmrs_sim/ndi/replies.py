"""The tracker's replies to ``TX`` and ``BX``: the poses of all tools and the status of the system.

The formats are those of NDI's API guide, commands TX and BX.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from pcmrs.messages import BodyPose
from pcmrs_sim.ndi.protocol import binary_reply, reply

OCCUPIED, INITIALIZED, ENABLED, OUT_OF_VOLUME, PARTIALLY_OUT = 0x01, 0x10, 0x20, 0x40, 0x80
INTERFERENCE, TEMPERATURE = 0x0002, 0x0100
"""Bits of a port's status, and of the system status."""

STATUS_OF = {"out_of_volume": OUT_OF_VOLUME, "partially_out": PARTIALLY_OUT}
SYSTEM_STATUS_OF = {"interference": INTERFERENCE, "temperature": TEMPERATURE}
"""Reasons for an invalid pose that a status bit reports, in the port's status and in the system status."""

VALID, MISSING, DISABLED = 1, 2, 4
"""Status of a handle in ``BX``."""


@dataclass(frozen=True)
class HandleReport:
    """One port handle in a reply.

    Attributes:
        handle: Number of the handle.
        status: Bits of its status that do not depend on a frame.
        pose: Pose of its tool in the newest frame; None while it is not enabled.
    """

    handle: int
    status: int
    pose: BodyPose | None

    @property
    def port_status(self) -> int:
        """Bits of the status, with those of this frame."""
        reason = self.pose.reason if self.pose is not None else None
        return self.status | STATUS_OF.get(reason or "", 0)


def system_status(reports: Sequence[HandleReport]) -> int:
    """Return the bits of the system status, which concerns all tools."""
    status = 0
    for report in reports:
        if report.pose is not None:
            status |= SYSTEM_STATUS_OF.get(report.pose.reason or "", 0)
    return status


def text_reply(reports: Sequence[HandleReport]) -> bytes:
    """Return the reply to ``TX 0001``: quaternions in 1e-4, positions in 1e-2 mm, the fit error in 1e-4 mm."""
    tools = "".join(f"{report.handle:02X}{_text_of(report)}\n" for report in reports)
    return reply(f"{len(reports):02X}{tools}{system_status(reports):04X}")


def float_reply(reports: Sequence[HandleReport]) -> bytes:
    """Return the reply to ``BX 0001``: quaternions, positions and fit errors, both in mm, in single precision."""
    tools = b"".join(bytes((report.handle,)) + _bytes_of(report) for report in reports)
    return binary_reply(bytes((len(reports),)) + tools + struct.pack("<H", system_status(reports)))


def numbers_of(pose: BodyPose) -> tuple[float, ...]:
    """Return quaternion w x y z, position and fit error, both in mm, (8,)."""
    return (*pose.quat_wxyz, *(1000.0 * value for value in pose.position), 1000.0 * pose.error)


def _text_of(report: HandleReport) -> str:
    if report.pose is None:
        return "DISABLED" + f"{report.status:08X}{0:08X}"
    numbers = numbers_of(report.pose) if report.pose.valid else (math.nan,)
    if all(math.isfinite(number) for number in numbers):
        digits = ((1e4, 5),) * 4 + ((1e2, 6),) * 3 + ((1e4, 5),)
        pose = "".join(_fixed(number, *each) for number, each in zip(numbers, digits, strict=True))
    else:
        pose = "MISSING"  # the text format cannot express a number that is not finite
    return pose + f"{report.port_status:08X}{report.pose.frame_number:08X}"


def _fixed(number: float, scale: float, digits: int) -> str:
    largest = 10**digits - 1
    return f"{max(-largest, min(largest, round(number * scale))):+0{digits + 1}d}"


def _bytes_of(report: HandleReport) -> bytes:
    if report.pose is None:
        return bytes((DISABLED,))
    tail = struct.pack("<II", report.port_status, report.pose.frame_number)
    if not report.pose.valid:
        return bytes((MISSING,)) + tail
    return bytes((VALID,)) + struct.pack("<8f", *numbers_of(report.pose)) + tail
