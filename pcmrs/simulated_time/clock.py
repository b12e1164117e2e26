"""Clocks of the processes of a cell in simulated time."""

from __future__ import annotations

import asyncio
from contextlib import AbstractAsyncContextManager
from typing import Any

__all__ = ["SimulatedClock"]

EPOCH = 1_700_000_000.0
"""Wall time at the start of every simulation, Unix seconds."""


class SimulatedClock:
    """Implementation of `pcmrs.clock.Clock` on the time of a simulated loop.

    All clocks of one loop share the same monotonic time, like the processes of one machine. Each has its own wall
    clock, which can be set like that of a host.

    Args:
        loop: Loop whose time it reads.

    Attributes:
        ahead: Offset of the wall clock from the true time, s.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self.ahead = 0.0
        self._frozen: float | None = None

    def monotonic(self) -> float:
        return self._loop.time()

    def wall(self) -> float:
        return EPOCH + self._loop.time() + self.ahead if self._frozen is None else self._frozen

    async def sleep(self, seconds: float) -> None:
        woken = self._loop.create_future()
        timer = self._loop.call_later(max(0.0, seconds), _wake, woken)
        try:
            await woken
        except asyncio.CancelledError:
            timer.cancel()
            raise

    def timeout(self, seconds: float) -> AbstractAsyncContextManager[Any]:
        return asyncio.timeout(seconds)

    def freeze(self, frozen: bool) -> None:
        """Stop the wall clock, or let it continue as if it had never stopped."""
        self._frozen = self.wall() if frozen else None


def _wake(woken: asyncio.Future[None]) -> None:
    if not woken.done():
        woken.set_result(None)
