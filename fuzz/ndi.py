"""NDI: what our reader process reports, and commands as the virtual tracker reads them.

The tracker's own replies are read by `ndicapi`, in that process, which is there so that a crash of it is survived.

    python -m fuzz.ndi -max_total_time=60
"""

from __future__ import annotations

import math
from contextlib import suppress

import atheris

from fuzz.running import pieces, run

with atheris.instrument_imports(include=["pcmrs.devices.ndi", "sim.ndi"]):
    from pcmrs.devices.ndi.poses import FrameReader
    from pcmrs.devices.ndi.wire import Failed, Frame, Ready, Report, ToolFrame, Unpacker, pack
    from pcmrs.errors import PayloadError
    from pcmrs.messages import BodyPose
    from sim.ndi.protocol import Lines, crc16
    from sim.ndi.system import NdiSystem

POSE = BodyPose(body="coil", frame_number=7, captured=0.0, sent=0.0, valid=True, position=(0.1, -0.2, -1.5), error=1e-4)


def read_reports(data: bytes) -> None:
    unpacker, reader = Unpacker(), FrameReader(0.03, 1e-3)
    try:
        reports: list[Report] = [report for piece in pieces(data) for report in unpacker.feed(piece)]
    except PayloadError:
        return
    for report in reports:
        assert isinstance(report, Ready | Frame | Failed)
        if isinstance(report, Frame):
            take(reader, report)


def take(reader: FrameReader, frame: Frame) -> None:
    for pose in reader.poses(frame, 1.0):
        assert pose.valid or pose.reason
        assert not pose.valid or pose.error <= 1e-3


def take_frames(data: bytes) -> None:
    """Frames of any number, status and pose, through the wire between the two processes."""
    reader, fuzzed = FrameReader(0.03, 1e-3), atheris.FuzzedDataProvider(data)
    while fuzzed.remaining_bytes():
        w, i, j, k, x, y, z, error = (fuzzed.ConsumeFloat() for _ in range(8))
        numbers = (w, i, j, k, x, y, z, error) if fuzzed.ConsumeBool() else None
        tool = ToolFrame("coil", fuzzed.ConsumeIntInRange(0, 2**32), fuzzed.ConsumeIntInRange(0, 2**32), numbers)
        arrived = fuzzed.ConsumeFloat()
        frame = Frame(arrived if math.isfinite(arrived) else 0.0, fuzzed.ConsumeIntInRange(0, 2**16), [tool])
        (read,) = Unpacker().feed(pack(frame))
        assert isinstance(read, Frame)
        take(reader, read)
        if fuzzed.ConsumeBool():
            reader.begin_anew()


def ask_tracker(data: bytes) -> None:
    """Raw bytes first, then the same as commands with the CRC they need."""
    system, lines = NdiSystem(lambda: [POSE], lambda: True), Lines()
    commands = [command for piece in pieces(data) for command in lines.feed(piece)]
    for command in commands:
        assert system.answer(command).endswith(b"\r") or command.startswith(b"BX")
        with suppress(ValueError):
            command.index(b":")
            assert system.answer(command + b"%04X" % crc16(command))


def one(data: bytes) -> None:
    kind, rest = data[:1], data[1:]
    if kind < b"\x40":
        read_reports(rest)
    elif kind < b"\x80":
        take_frames(rest)
    else:
        ask_tracker(rest)


if __name__ == "__main__":
    setting_up = b"INIT:E3A5\rPHRQ \rPINIT 01\rPENA 01D\rTSTART \rTX 0001\rBX 0001\rTSTOP \rPHSR 00\rVER 0\r"
    writing = b"INIT \rPHRQ *********1****\rPVWR 010000" + b"4E" * 64 + b"\rPINIT 01\rPENA 01D\rTSTART \rBX 0001\r"
    frame = pack(Frame(1.0, 0, [ToolFrame("coil", 3, 0x31, (1.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 0.1))]))
    run(one, b"\x00\x00" + frame + pack(Failed("no")), b"\x50", b"\xff\x00" + setting_up, b"\xff\x00" + writing)
