"""A daemon that answers commands and Stops at the edge of the bus, for tests."""

import asyncio
from collections import Counter
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import zenoh
from msgspec.structs import replace

from pcmrs.bus import Bus, CommandEdge
from pcmrs.messages import Command, Verdict
from pcmrs.messages.identity import Identity
from tests.unit.bus.bus_cells import accepted, new_cell, open_bus, plain_session

HELD_UP = 1.0
"""The loop does something else for so long, s."""

FLOOD = 2_000
"""Presses of one who never stops pressing."""

PLAN = "cmd/local/registration/plan_landmarks"


class Daemon:
    """What stands behind the edge in these tests: it remembers, and accepts everything."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.submitted: asyncio.Queue[Command] = asyncio.Queue()
        self.stopped: asyncio.Queue[str] = asyncio.Queue()
        self.stops = 0
        self.presses: Counter[str] = Counter()
        self.ages: list[float] = []
        self.refused: list[tuple[str, str]] = []
        self.texts: list[str] = []

    def refuse(self, source: str, code: str, text: str) -> None:
        self.refused.append((source, code))
        self.texts.append(text)

    def stop(self, source: str, presses: int) -> int:
        """Numbers each Stop, from 1."""
        self.stopped.put_nowait(source)
        self.presses[source] += presses
        self.stops += 1
        return self.stops

    async def submit(self, command: Command, *, arrived: float | None) -> Verdict:
        assert arrived is not None
        self.submitted.put_nowait(command)
        self.ages.append(asyncio.get_running_loop().time() - arrived)
        return accepted(command)


@asynccontextmanager
async def running_daemon(*members: Identity) -> AsyncIterator[tuple[Daemon, zenoh.Session]]:
    async with open_bus(replace(new_cell(), members=members)) as bus:
        daemon = Daemon(bus)
        edge = await CommandEdge.open(bus, daemon.submit, daemon.refuse, daemon.stop)
        try:
            with plain_session(bus.settings) as session:
                yield daemon, session
        finally:
            await edge.close()


async def get(daemon: Daemon, session: zenoh.Session, key: str, payload: bytes | None = None) -> bytes:
    replies = await asyncio.to_thread(lambda: list(session.get(f"{daemon.bus.prefix}/{key}", payload=payload)))
    (reply,) = replies
    return bytes(reply.result.payload.to_bytes())
