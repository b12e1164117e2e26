"""A slow consumer: a process of its own that hears the poses of a cell, and takes none for as long as it is told.

    python -m pcmrs.campaign.consumer ENDPOINT CELL

It prints a line when the first pose has come, keeps its event loop busy until it is sent a line, and prints `Heard`.
"""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress

import msgspec

from pcmrs.bus import Bus, BusSettings
from pcmrs.campaign.driving import PATIENCE
from pcmrs.campaign.fault import Unmet
from pcmrs.campaign.lab import LabCell
from pcmrs.campaign.sham import bring_about
from pcmrs.messages import BodyPose

POSES = "state/pose/coil"
SETTLING = 0.2
"""What has waited in its socket was read within this, s of the machine."""


class Heard(msgspec.Struct, frozen=True):
    """What has become of the poses that were sent.

    Attributes:
        sent: By their frame numbers, from the first that was heard to the last.
        heard: Of these.
        counted: As dropped, by the bus of the consumer.
    """

    sent: int
    heard: int
    counted: int

    @property
    def lost(self) -> int:
        """Sent and not heard."""
        return self.sent - self.heard


@asynccontextmanager
async def slow_consumer(cell: LabCell, *, frozen: bool) -> AsyncIterator[Callable[[], Awaitable[Heard]]]:
    """A consumer that takes nothing from now on.

    Args:
        cell: Whose poses it hears.
        frozen: Nothing of it runs, so that it does not even read its socket; otherwise its event loop is busy.

    Yields:
        Lets it go on, and returns what it has heard.

    Raises:
        Unmet: It hears nothing, or has ended.
    """
    pipe = asyncio.subprocess.PIPE
    words = (sys.executable, "-m", "pcmrs.campaign.consumer", cell.ready.endpoint, cell.name)
    process = await asyncio.create_subprocess_exec(*words, stdin=pipe, stdout=pipe)

    async def go_on() -> Heard:
        process.send_signal(signal.SIGCONT)
        return msgspec.json.decode(await _line(process, b"\n"), type=Heard)

    try:
        await _line(process, b"")
        if frozen:
            bring_about(lambda: os.kill(process.pid, signal.SIGSTOP))
        yield go_on
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()


async def _line(process: asyncio.subprocess.Process, told: bytes) -> bytes:
    if process.stdin is None or process.stdout is None:
        raise ValueError("The consumer has no pipes.")
    process.stdin.write(told)
    async with asyncio.timeout(PATIENCE):
        line = await process.stdout.readline()
    if not line:
        raise Unmet("The consumer has ended.")
    return line


async def consume(endpoint: str, cell: str) -> Heard:
    """Hears poses, none while nobody has sent a line, and then what is left of them."""
    bus = await Bus.open(BusSettings(endpoint=endpoint, cell=cell))
    frames: list[int] = []
    hears = asyncio.Event()

    def hear(_: str, pose: BodyPose) -> None:
        frames.append(pose.frame_number)
        hears.set()

    end = bus.subscribe(POSES, BodyPose, hear)
    await hears.wait()
    before, first = bus.counters()["bus.replaced"], len(frames) - 1
    _tell(b"hears")
    sys.stdin.readline()  # in the event loop, for that very reason: it has no time for anything else
    await asyncio.sleep(SETTLING)
    await end()
    counted = bus.counters()["bus.replaced"] - before
    await bus.close()
    return Heard(frames[-1] - frames[first] + 1, len(frames) - first, counted)


def _tell(line: bytes) -> None:
    sys.stdout.buffer.write(line + b"\n")
    sys.stdout.flush()


if __name__ == "__main__":
    _tell(msgspec.json.encode(asyncio.run(consume(*sys.argv[1:]))))
