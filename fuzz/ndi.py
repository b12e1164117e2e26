"""NDI: reports of our reader process, and commands to the virtual tracker.

`ndicapi` reads the tracker's own replies in that process, whose purpose is to survive its crashes.

    python -m fuzz.ndi -max_total_time=60
"""

from __future__ import annotations

import math
import struct
from contextlib import suppress

from fuzz.running import instrumented, pieces, run

with instrumented("pcmrs.devices.ndi", "pcmrs_sim.ndi"):
    from pcmrs.devices.ndi.poses import FrameReader
    from pcmrs.devices.ndi.wire import Failed, NdiFrame, Report, ToolFrame, TrackerReady, Unpacker, pack
    from pcmrs.errors import PayloadError
    from pcmrs.messages import BodyPose
    from pcmrs_sim.ndi.protocol import Lines, crc16
    from pcmrs_sim.ndi.system import NdiSystem

FRAME = struct.Struct("<8d?IIdH?")
"""Pose, error, visibility, number, status, time of arrival, status of the system, restart."""
POSE = BodyPose(body="coil", frame_number=7, captured=0.0, sent=0.0, valid=True, position=(0.1, -0.2, -1.5), error=1e-4)


def read_reports(data: bytes) -> None:
    """Unpack reports and read their frames."""
    unpacker, reader = Unpacker(), FrameReader(0.03, 1e-3)
    try:
        reports: list[Report] = [report for piece in pieces(data) for report in unpacker.feed(piece)]
    except PayloadError:
        return
    for report in reports:
        assert isinstance(report, TrackerReady | NdiFrame | Failed)
        if isinstance(report, NdiFrame):
            take(reader, report)


def take(reader: FrameReader, frame: NdiFrame) -> None:
    """Read one frame, and check its poses.

    Args:
        reader: Reader of frames.
        frame: NdiFrame of the tracker.
    """
    for pose in reader.poses(frame, 1.0):
        assert pose.valid or pose.reason
        assert not pose.valid or pose.error <= 1e-3


def take_frames(data: bytes) -> None:
    """Pass frames of any number, status and pose through the protocol between the two processes."""
    reader = FrameReader(0.03, 1e-3)
    whole = len(data) // FRAME.size * FRAME.size
    for w, i, j, k, x, y, z, error, seen, number, status, arrived, system, restarts in FRAME.iter_unpack(data[:whole]):
        numbers = (w, i, j, k, x, y, z, error) if seen else None
        tool = ToolFrame("coil", number, status, numbers)
        frame = NdiFrame(arrived if math.isfinite(arrived) else 0.0, system, [tool])
        (read,) = Unpacker().feed(pack(frame))
        assert isinstance(read, NdiFrame)
        take(reader, read)
        if restarts:
            reader.restart()


def send_to_tracker(data: bytes) -> None:
    """Send raw bytes, and then the same commands with a correct CRC."""
    system, lines = NdiSystem(lambda: [POSE], lambda: True), Lines()
    commands = [command for piece in pieces(data) for command in lines.feed(piece)]
    for command in commands:
        assert system.answer(command).endswith(b"\r") or command.startswith(b"BX")
        with suppress(ValueError):
            command.index(b":")
            assert system.answer(command + b"%04X" % crc16(command))


def one(data: bytes) -> None:
    """Select a target by the first byte."""
    kind, rest = data[:1], data[1:]
    if kind < b"\x40":
        read_reports(rest)
    elif kind < b"\x80":
        take_frames(rest)
    else:
        send_to_tracker(rest)


if __name__ == "__main__":
    run(one)
