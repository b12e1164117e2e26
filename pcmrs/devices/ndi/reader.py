"""The process that talks to the tracker, for `ndicapi`'s reads have no timeout and its calls hold the interpreter.

It takes one `Job` on standard input, writes reports to standard output, and ends with whoever holds the other ends.
A call that does not return is ended by the alarm of the operating system, which needs no interpreter, and so is this
process.
"""

from __future__ import annotations

import select
import signal
import socket
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import ndicapy

from pcmrs.clock import SystemClock
from pcmrs.devices.ndi.wire import Failed, Frame, Job, Ready, Report, ToolFrame, pack, read_job

SETUP_TIME = 8.0
"""A command that sets the tracker up is answered within this, s: longer than `ndicapi` waits on a serial link, 5."""
CONNECT_TIME = 3.0
"""A network link is there within this, s."""
ANSWER_TIME = 1.0
"""It answers within this when it tracks, s."""
POLL_TIME = 0.003
"""Between two questions, s: the most by which the age of a frame is unknown, besides the link."""

BAUDS = {9600: 0, 14400: 1, 19200: 2, 38400: 3, 57600: 4, 115200: 5, 921600: 6}
CHUNK = 64
ROOM = 1024

Device = object
"""A link as `ndicapi` has it."""


def main() -> None:
    """Reads a job and performs it until standard input ends."""
    job = read_job(sys.stdin.buffer)
    with suppress(BrokenPipeError):
        try:
            for report in _reports(job):
                _send(report)
        except OSError as error:  # what ndicapi raises
            _send(Failed(str(error)))


def _send(report: Report) -> None:
    sys.stdout.buffer.write(pack(report))
    sys.stdout.buffer.flush()


def _reports(job: Job) -> Iterator[Report]:
    device = _open(job)
    handles = _load(device, job.tools)
    version = _ask(device, "VER:0")
    _ask(device, "TSTART:")
    binary = _is_binary(device)
    yield Ready(version, binary)
    clock = SystemClock()
    while not select.select([sys.stdin], [], [], POLL_TIME)[0]:
        _ask(device, "BX:0001" if binary else "TX:0001", ANSWER_TIME)
        yield _frame(device, handles, binary, clock.monotonic())


@contextmanager
def _alarm(time: float) -> Iterator[None]:
    """Ends the process by SIGALRM when what is in it has not ended in `time` s."""
    signal.setitimer(signal.ITIMER_REAL, time)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def _open(job: Job) -> Device:
    host, colon, port = job.device.rpartition(":")
    if colon and port.isdecimal():
        try:
            socket.create_connection((host, int(port)), CONNECT_TIME).close()
        except OSError as error:
            raise OSError(f"nothing listens there ({error.strerror or error})") from None
        device = ndicapy.ndiOpenNetwork(host, int(port))  # which does not say when it has failed
        _initialize(device)
        return device
    device = ndicapy.ndiOpen(job.device)
    if device is None:
        raise OSError("this cannot be opened as a serial port")
    _initialize(device)
    _ask(device, f"COMM:{BAUDS[job.baud]}0000")
    return device


def _initialize(device: Device) -> None:
    """Brings a tracker that may still be tracking for a process that has gone into its beginning."""
    with suppress(OSError):  # where it does not track
        _ask(device, "TSTOP:")
    try:
        _ask(device, "INIT:")
    except OSError:
        _ask(device, "RESET:0")
        _ask(device, "INIT:")


def _load(device: Device, tools: dict[str, bytes]) -> dict[str, int]:
    """Body to its port handle, with the tool enabled."""
    _ask(device, "PHSR:00")
    for handle in [ndicapy.ndiGetPHSRHandle(device, i) for i in range(ndicapy.ndiGetPHSRNumberOfHandles(device))]:
        _ask(device, f"PHF:{handle:02X}")
    return {body: _load_tool(device, srom) for body, srom in tools.items()}


def _load_tool(device: Device, srom: bytes) -> int:
    _ask(device, "PHRQ:*********1****")
    handle: int = ndicapy.ndiGetPHRQHandle(device)
    content = srom.ljust(ROOM, b"\0")
    for start in range(0, ROOM, CHUNK):
        _ask(device, f"PVWR:{handle:02X}{start:04X}{content[start : start + CHUNK].hex().upper()}")
    _ask(device, f"PINIT:{handle:02X}")
    _ask(device, f"PENA:{handle:02X}D")
    return handle


def _is_binary(device: Device) -> bool:
    """Whether the tracker knows ``BX``; an old one does not."""
    try:
        _ask(device, "BX:0001")
    except OSError:
        return False
    return True


def _ask(device: Device, command: str, time: float = SETUP_TIME) -> str:
    """Sends a command and returns its answer, that of ``BX`` empty: `ndicapi` has taken it apart by then.

    Raises:
        OSError: The tracker answers with an error, or the link fails.
    """
    try:
        with _alarm(time):
            return str(ndicapy.ndiCommand(device, command))
    except UnicodeDecodeError:  # the bytes of BX are no text
        return ""
    except OSError as error:
        raise OSError(f"{command.partition(':')[0]} failed: {error}") from None


def _frame(device: Device, handles: dict[str, int], binary: bool, arrived: float) -> Frame:
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
        tools.append(ToolFrame(body, number(device, port), known_bits(status(device, port)), seen))
    return Frame(arrived, known_bits(system), tools)


def known_bits(status: int) -> int:
    """What is left of a status word of which `ndicapi` 3.7 extends the sign of each byte that it takes from ``BX``."""
    if status < 1 << 32:
        return status
    return next(status & (1 << bits) - 1 for bits in (8, 16, 24, 32) if status & 1 << bits - 1)


if __name__ == "__main__":
    main()
