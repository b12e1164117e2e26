"""The reader process, which talks to the tracker: `ndicapi`'s reads have no timeout, and its calls hold the GIL.

It reads one `ReaderJob` from standard input, writes reports to standard output, and ends with its parent. While it
tracks, each further byte of its input is a number of beeps. A call that does not return is ended, with this process, by
SIGALRM, which needs no Python interpreter.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import ndicapy

from pcmrs.clock import SystemClock
from pcmrs.devices.ndi.wire import Failed, NdiFrame, ReaderJob, Report, ToolFrame, TrackerReady, pack, read_job

SETUP_TIME = 8.0
"""Longest wait for the answer to a set-up command, s: longer than the 5 s that `ndicapi` waits on a serial link."""
CONNECT_TIME = 3.0
"""Longest wait for a network link, s."""
ANSWER_TIME = 1.0
"""Longest wait for an answer while the tracker tracks, s."""
POLL_TIME = 0.003
"""Time between two polls, s: the uncertainty of a frame's age, besides the delay of the link."""

BAUDS = {9600: 0, 14400: 1, 19200: 2, 38400: 3, 57600: 4, 115200: 5, 921600: 6}
"""Code of each baud rate in the command ``COMM``."""
MOST_BEEPS = 16
"""Number of requests for beeps that are taken at once."""
CHUNK = 64
"""Number of bytes of a tool definition in one ``PVWR``."""
ROOM = 1024
"""Memory of the tracker for a tool definition, bytes."""

Device = object
"""A link of `ndicapi`."""


def main() -> None:
    """Read a job and perform it until standard input ends."""
    job = read_job(sys.stdin.buffer)
    with suppress(BrokenPipeError):
        try:
            for report in _reports(job):
                _send(report)
        except OSError as error:  # `ndicapi` raises this
            _send(Failed(str(error)))


def _send(report: Report) -> None:
    sys.stdout.buffer.write(pack(report))
    sys.stdout.buffer.flush()


def _reports(job: ReaderJob) -> Iterator[Report]:
    device = _open(job)
    handles = _load(device, job.tools)
    version = _command(device, "VER:0")
    _command(device, "TSTART:")
    binary = _is_binary(device)
    yield TrackerReady(version, binary)
    clock = SystemClock()
    while _obey(device):
        _command(device, "BX:0001" if binary else "TX:0001", ANSWER_TIME)
        yield _frame(device, handles, binary, clock.monotonic())


def _obey(device: Device) -> bool:
    """Wait a little for what the parent asks, and sound the beeps; return False when the parent has ended."""
    if not select.select([sys.stdin], [], [], POLL_TIME)[0]:
        return True
    asked = os.read(sys.stdin.fileno(), MOST_BEEPS)
    for count in asked:
        with suppress(OSError):  # a tracker that still beeps refuses the next ones
            _command(device, f"BEEP:{count}", ANSWER_TIME)
    return bool(asked)


@contextmanager
def _alarm(time: float) -> Iterator[None]:
    """End the process by SIGALRM if the block takes longer than `time` s."""
    signal.setitimer(signal.ITIMER_REAL, time)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _open(job: ReaderJob) -> Device:
    host, colon, port = job.device.rpartition(":")
    if colon and port.isdecimal():
        try:
            socket.create_connection((host, int(port)), CONNECT_TIME).close()
        except OSError as error:
            raise OSError(f"nothing listens there ({error.strerror or error})") from None
        device = ndicapy.ndiOpenNetwork(host, int(port))  # does not report a failure, so the port was tried before
        _initialize(device)
        return device
    device = ndicapy.ndiOpen(job.device)
    if device is None:
        raise OSError("this cannot be opened as a serial port")
    _initialize(device)
    _command(device, f"COMM:{BAUDS[job.baud]}0000")
    return device


def _initialize(device: Device) -> None:
    """Reset a tracker that may still be tracking for an earlier process."""
    with suppress(OSError):  # if it does not track
        _command(device, "TSTOP:")
    try:
        _command(device, "INIT:")
    except OSError:
        _command(device, "RESET:0")
        _command(device, "INIT:")


def _load(device: Device, tools: dict[str, bytes]) -> dict[str, int]:
    """Load and enable the tools, and return the port handle of each body."""
    _command(device, "PHSR:00")
    for handle in [ndicapy.ndiGetPHSRHandle(device, i) for i in range(ndicapy.ndiGetPHSRNumberOfHandles(device))]:
        _command(device, f"PHF:{handle:02X}")
    return {body: _load_tool(device, srom) for body, srom in tools.items()}


def _load_tool(device: Device, srom: bytes) -> int:
    _command(device, "PHRQ:*********1****")
    handle: int = ndicapy.ndiGetPHRQHandle(device)
    content = srom.ljust(ROOM, b"\0")
    for start in range(0, ROOM, CHUNK):
        _command(device, f"PVWR:{handle:02X}{start:04X}{content[start : start + CHUNK].hex().upper()}")
    _command(device, f"PINIT:{handle:02X}")
    _command(device, f"PENA:{handle:02X}D")
    return handle


def _is_binary(device: Device) -> bool:
    """Return True if the tracker knows ``BX``; an old one does not."""
    try:
        _command(device, "BX:0001")
    except OSError:
        return False
    return True


def _command(device: Device, command: str, time: float = SETUP_TIME) -> str:
    """Send a command and return its answer; that of ``BX`` is empty, because `ndicapi` has parsed it already.

    Raises:
        OSError: The tracker answers with an error, or the link fails.
    """
    try:
        with _alarm(time):
            return str(ndicapy.ndiCommand(device, command))
    except UnicodeDecodeError:  # the answer to BX is not text
        return ""
    except OSError as error:
        raise OSError(f"{command.partition(':')[0]} failed: {error}") from None


def _frame(device: Device, handles: dict[str, int], binary: bool, arrived: float) -> NdiFrame:
    if binary:
        transform, status, number = ndicapy.ndiGetBXTransform, ndicapy.ndiGetBXPortStatus, ndicapy.ndiGetBXFrame
        system = ndicapy.ndiGetBXSystemStatus(device)
    else:
        transform, status, number = ndicapy.ndiGetTXTransform, ndicapy.ndiGetTXPortStatus, ndicapy.ndiGetTXFrame
        system = ndicapy.ndiGetTXSystemStatus(device)
    tools = []
    for body, handle in handles.items():
        port = bytes((handle,))
        numbers = transform(device, port)
        seen = None if isinstance(numbers, str) else numbers
        tools.append(ToolFrame(body, number(device, port), without_sign_extension(status(device, port)), seen))
    return NdiFrame(arrived, without_sign_extension(system), tools)


def without_sign_extension(status: int) -> int:
    """Return the bits of a status word in which `ndicapi` 3.7 sign-extends each byte of the answer to ``BX``."""
    if status < 1 << 32:
        return status
    return next(status & (1 << bits) - 1 for bits in (8, 16, 24, 32) if status & 1 << bits - 1)


if __name__ == "__main__":
    main()
