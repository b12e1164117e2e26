"""Clocks for tests: one whose time only the test advances, and one whose wall clock can be set."""

from __future__ import annotations

import asyncio
import heapq
import itertools
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from pcmrs.clock import SystemClock

__all__ = ["ManualClock", "SetClock", "settle"]

EPOCH = 1_700_000_000.0
"""Offset of the wall time of a `ManualClock`, Unix seconds."""
SPINS = 50
"""Number of turns after which the event loop is settled in any case."""
IDLE_SPINS = 5
"""Number of turns in a row in which no other callback was ready, after which the event loop is settled."""


async def settle() -> None:
    """Let the event loop run until all tasks wait."""
    # A loop that does not say what is ready has all its turns.
    ready = getattr(asyncio.get_running_loop(), "_ready", True)
    idle = 0
    for _ in range(SPINS):
        await asyncio.sleep(0)
        idle = 0 if ready else idle + 1
        if idle == IDLE_SPINS:
            return


class ManualClock:
    """Implementation of `pcmrs.clock.Clock`; `advance` is the only thing that makes time pass."""

    def __init__(self) -> None:
        self._now = 100.0
        self._numbers = itertools.count()
        self._due: list[tuple[float, int, Callable[[], None]]] = []

    def monotonic(self) -> float:
        return self._now

    def wall(self) -> float:
        return EPOCH + self._now

    async def sleep(self, seconds: float) -> None:
        woken = asyncio.get_running_loop().create_future()
        self._at(seconds, lambda: None if woken.done() else woken.set_result(None))
        await woken

    @asynccontextmanager
    async def timeout(self, seconds: float) -> AsyncIterator[None]:
        async with asyncio.timeout(None) as deadline:
            entry = self._at(seconds, lambda: deadline.reschedule(0))
            try:
                yield
            finally:
                if entry in self._due:
                    self._due.remove(entry)
                    heapq.heapify(self._due)

    async def advance(self, seconds: float) -> None:
        """Advance time by `seconds`; each waiter that falls due runs, in order, before time advances further."""
        end = self._now + seconds
        while self._due and self._due[0][0] <= end:
            due, _, wake = heapq.heappop(self._due)
            self._now = max(self._now, due)
            wake()
            await settle()
        self._now = max(self._now, end)
        await settle()

    def stall(self, seconds: float) -> None:
        """Advance time by `seconds` without running any waiter, as on a busy machine."""
        self._now += seconds

    def _at(self, seconds: float, wake: Callable[[], None]) -> tuple[float, int, Callable[[], None]]:
        entry = (self._now + seconds, next(self._numbers), wake)
        heapq.heappush(self._due, entry)
        return entry


class SetClock(SystemClock):
    """The clock of a machine whose wall clock is set while it runs.

    Attributes:
        ahead: Offset of the wall clock from its true time, s.
    """

    ahead = 0.0

    def wall(self) -> float:
        return super().wall() + self.ahead
