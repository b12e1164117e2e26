"""Slow consumer: a separate process that subscribes to the poses of a cell and reads none until it is resumed.

    python -m pcmrs_lab.campaign.consumer ENDPOINT CELL busy|idle

It prints a line when it has received the first pose, keeps its event loop busy or idle until it receives a line, and
prints a `ConsumerReport`.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Literal

import msgspec

from pcmrs.bus import Bus, BusSettings
from pcmrs.killing import kill_and_wait
from pcmrs.messages import BodyPose
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.driving import PATIENCE
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.samples import process_state
from pcmrs_lab.campaign.sham import inject_unless_sham, is_sham

Manner = Literal["frozen", "busy", "idle"]
"""State of a consumer: frozen (stopped by a signal, so its socket is not read), busy (its event loop is blocked), or
idle."""

POSES = "state/pose/coil"
SETTLING = 0.2
"""Time in which the messages that wait in the socket are read, s of the machine."""


class ConsumerReport(msgspec.Struct, frozen=True):
    """Number of poses that were sent, received and dropped.

    Attributes:
        sent: Poses that were sent from the first that was received to the last, by their frame numbers.
        received: Poses of these that were received.
        counted: Poses that the consumer's bus counted as dropped.
        was: State of the process before it was resumed, as the kernel reports it; T is stopped.
    """

    sent: int
    received: int
    counted: int
    was: str = ""

    @property
    def lost(self) -> int:
        """Number of poses that were sent and not received."""
        return self.sent - self.received


@asynccontextmanager
async def consumer(cell: RunningCell, manner: Manner) -> AsyncIterator[Callable[[], Awaitable[ConsumerReport]]]:
    """Start a consumer that reads nothing from now on, or everything if it is idle, as always in a sham campaign.

    Args:
        cell: Cell whose poses it subscribes to.
        manner: State in which it is kept.

    Yields:
        Function that resumes it and returns its report.

    Raises:
        Unmet: It receives nothing, or has ended.
    """
    pipe = asyncio.subprocess.PIPE
    state = "busy" if manner == "busy" and not is_sham() else "idle"
    words = (sys.executable, "-m", "pcmrs_lab.campaign.consumer", cell.ready.endpoint, cell.name, state)
    process = await asyncio.create_subprocess_exec(*words, stdin=pipe, stdout=pipe)

    async def resume() -> ConsumerReport:
        was = process_state(process.pid)
        process.send_signal(signal.SIGCONT)
        received = msgspec.json.decode(await _line(process, b"\n"), type=ConsumerReport)
        return msgspec.structs.replace(received, was=was)

    try:
        await _line(process, b"")
        if manner == "frozen":
            inject_unless_sham(lambda: os.kill(process.pid, signal.SIGSTOP))
        yield resume
    finally:
        await kill_and_wait(process)


async def _line(process: asyncio.subprocess.Process, text: bytes) -> bytes:
    if process.stdin is None or process.stdout is None:
        raise ValueError("The consumer has no pipes.")
    process.stdin.write(text)
    async with asyncio.timeout(PATIENCE):
        line = await process.stdout.readline()
    if not line:
        raise Unmet("The consumer has ended.")
    return line


async def consume(endpoint: str, cell: str, manner: str) -> ConsumerReport:
    """Receive poses; unless idle, read none until a line is received, and then the rest.

    Args:
        endpoint: Zenoh endpoint of the bus.
        cell: Name of the cell.
        manner: ``busy`` or ``idle``.

    Returns:
        Number of poses that were sent, received and dropped.
    """
    bus = await Bus.open(BusSettings(endpoint=endpoint, cell=cell))
    frames: list[int] = []
    ready = asyncio.Event()

    def receive(_: str, pose: BodyPose) -> None:
        frames.append(pose.frame_number)
        ready.set()

    end = bus.subscribe(POSES, BodyPose, receive)
    await ready.wait()
    before, first = bus.counters()["bus.replaced"], len(frames) - 1
    _print_line(b"ready")
    if manner == "idle":
        await asyncio.to_thread(sys.stdin.readline)
    else:
        sys.stdin.readline()  # blocks the event loop on purpose
    await asyncio.sleep(SETTLING)
    await end()
    counted = bus.counters()["bus.replaced"] - before
    await bus.close()
    return ConsumerReport(frames[-1] - frames[first] + 1, len(frames) - first, counted)


def _print_line(line: bytes) -> None:
    sys.stdout.buffer.write(line + b"\n")
    sys.stdout.flush()


if __name__ == "__main__":
    _print_line(msgspec.json.encode(asyncio.run(consume(*sys.argv[1:]))))
