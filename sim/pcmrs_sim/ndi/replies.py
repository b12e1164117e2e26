"""What a tracker answers to ``TX`` and ``BX``: the poses of all tools and the state of the system."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass

from pcmrs.messages import BodyPose
from pcmrs_sim.ndi.protocol import binary_reply, reply

OCCUPIED, INITIALIZED, ENABLED, OUT_OF_VOLUME, PARTIALLY_OUT = 0x01, 0x10, 0x20, 0x40, 0x80
INTERFERENCE, TEMPERATURE = 0x0002, 0x0100
"""Bits of a port's status, and of the system's."""

STATUS_OF = {"out_of_volume": OUT_OF_VOLUME, "partially_out": PARTIALLY_OUT}
SYSTEM_STATUS_OF = {"interference": INTERFERENCE, "temperature": TEMPERATURE}
"""Reasons that a status bit tells."""

VALID, MISSING, DISABLED = 1, 2, 4
"""A handle's state in ``BX``."""


@dataclass(frozen=True)
class Sight:
    """What there is to say about one port handle; `pose` is None while it is not enabled."""

    handle: int
    status: int
    pose: BodyPose | None

    @property
    def port_status(self) -> int:
        """With what the tracker says of this frame."""
        reason = self.pose.reason if self.pose is not None else None
        return self.status | STATUS_OF.get(reason or "", 0)


def system_status(sights: Sequence[Sight]) -> int:
    """What concerns all tools."""
    status = 0
    for sight in sights:
        if sight.pose is not None:
            status |= SYSTEM_STATUS_OF.get(sight.pose.reason or "", 0)
    return status


def text_reply(sights: Sequence[Sight]) -> bytes:
    """Answers ``TX 0001``: quaternions in 1e-4, millimetres in 1e-2, the fit error in 1e-4 mm."""
    tools = "".join(f"{sight.handle:02X}{_text_of(sight)}\n" for sight in sights)
    return reply(f"{len(sights):02X}{tools}{system_status(sights):04X}")


def float_reply(sights: Sequence[Sight]) -> bytes:
    """Answers ``BX 0001``: the same in single precision."""
    tools = b"".join(bytes((sight.handle,)) + _bytes_of(sight) for sight in sights)
    return binary_reply(bytes((len(sights),)) + tools + struct.pack("<H", system_status(sights)))


def numbers_of(pose: BodyPose) -> tuple[float, ...]:
    """Quaternion w x y z, translation and fit error, both in mm, (8,)."""
    return (*pose.quat_wxyz, *(1000.0 * value for value in pose.position), 1000.0 * pose.error)


def _text_of(sight: Sight) -> str:
    if sight.pose is None:
        return "DISABLED" + f"{sight.status:08X}{0:08X}"
    numbers = numbers_of(sight.pose) if sight.pose.valid else (math.nan,)
    if all(math.isfinite(number) for number in numbers):
        digits = ((1e4, 5),) * 4 + ((1e2, 6),) * 3 + ((1e4, 5),)
        pose = "".join(_fixed(number, *each) for number, each in zip(numbers, digits, strict=True))
    else:
        pose = "MISSING"  # text has no way to say that a number is none
    return pose + f"{sight.port_status:08X}{sight.pose.frame_number:08X}"


def _fixed(number: float, scale: float, digits: int) -> str:
    largest = 10**digits - 1
    return f"{max(-largest, min(largest, round(number * scale))):+0{digits + 1}d}"


def _bytes_of(sight: Sight) -> bytes:
    if sight.pose is None:
        return bytes((DISABLED,))
    tail = struct.pack("<II", sight.port_status, sight.pose.frame_number)
    if not sight.pose.valid:
        return bytes((MISSING,)) + tail
    return bytes((VALID,)) + struct.pack("<8f", *numbers_of(sight.pose)) + tail
