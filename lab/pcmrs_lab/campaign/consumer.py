"""A slow consumer: a process of its own that hears the poses of a cell, and takes none for as long as it is told.

    python -m pcmrs_lab.campaign.consumer ENDPOINT CELL busy|idle

It prints a line when the first pose has come, keeps its event loop busy or idle until it is sent a line, and prints
`Heard`.
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
from pcmrs_lab.campaign.sham import bring_about, is_sham

Manner = Literal["frozen", "busy", "idle"]
"""Nothing of a consumer runs, so that it does not even read its socket; its event loop is busy; or it has time."""

POSES = "state/pose/coil"
SETTLING = 0.2
"""What has waited in its socket was read within this, s of the machine."""


class Heard(msgspec.Struct, frozen=True):
    """What has become of the poses that were sent.

    Attributes:
        sent: By their frame numbers, from the first that was heard to the last.
        heard: Of these.
        counted: As dropped, by the bus of the consumer.
        was: State of its process before it was let go on, as the kernel has it; T is stopped.
    """

    sent: int
    heard: int
    counted: int
    was: str = ""

    @property
    def lost(self) -> int:
        """Sent and not heard."""
        return self.sent - self.heard


@asynccontextmanager
async def consumer(cell: RunningCell, manner: Manner) -> AsyncIterator[Callable[[], Awaitable[Heard]]]:
    """A consumer that takes nothing from now on, or everything where it is idle; in a sham campaign it is always idle.

    Args:
        cell: Whose poses it hears.
        manner: What keeps it.

    Yields:
        Lets it go on, and returns what it has heard.

    Raises:
        Unmet: It hears nothing, or has ended.
    """
    pipe = asyncio.subprocess.PIPE
    kept = "busy" if manner == "busy" and not is_sham() else "idle"
    words = (sys.executable, "-m", "pcmrs_lab.campaign.consumer", cell.ready.endpoint, cell.name, kept)
    process = await asyncio.create_subprocess_exec(*words, stdin=pipe, stdout=pipe)

    async def go_on() -> Heard:
        was = process_state(process.pid)
        process.send_signal(signal.SIGCONT)
        heard = msgspec.json.decode(await _line(process, b"\n"), type=Heard)
        return msgspec.structs.replace(heard, was=was)

    try:
        await _line(process, b"")
        if manner == "frozen":
            bring_about(lambda: os.kill(process.pid, signal.SIGSTOP))
        yield go_on
    finally:
        await kill_and_wait(process)


async def _line(process: asyncio.subprocess.Process, told: bytes) -> bytes:
    if process.stdin is None or process.stdout is None:
        raise ValueError("The consumer has no pipes.")
    process.stdin.write(told)
    async with asyncio.timeout(PATIENCE):
        line = await process.stdout.readline()
    if not line:
        raise Unmet("The consumer has ended.")
    return line


async def consume(endpoint: str, cell: str, manner: str) -> Heard:
    """Hears poses, none while nobody has sent a line unless it is idle, and then what is left of them."""
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
    if manner == "idle":
        await asyncio.to_thread(sys.stdin.readline)
    else:
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
