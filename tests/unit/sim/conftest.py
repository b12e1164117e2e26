"""A cell whose time passes only when everybody waits."""

import asyncio
import heapq
import itertools
from collections.abc import AsyncIterator, Mapping
from contextlib import AbstractAsyncContextManager, suppress
from typing import Any

import pytest

from pcmrs_sim.opening import open_devices

TURNS = 20  # of the event loop that any chain of reactions in these tests may take


class VirtualClock:
    """Jumps to the next deadline once the event loop has had its turns."""

    def __init__(self) -> None:
        self.now = 100.0
        self._sleepers: list[tuple[float, int, asyncio.Future[None]]] = []
        self._order = itertools.count()

    def monotonic(self) -> float:
        return self.now

    def wall(self) -> float:
        return self.now

    async def sleep(self, seconds: float) -> None:
        woken = asyncio.get_running_loop().create_future()
        heapq.heappush(self._sleepers, (self.now + seconds, next(self._order), woken))
        await woken

    def timeout(self, seconds: float) -> AbstractAsyncContextManager[Any]:
        raise NotImplementedError

    async def run(self) -> None:
        while True:
            for _ in range(TURNS):
                await asyncio.sleep(0)
            if self._sleepers:
                self.now, _, woken = heapq.heappop(self._sleepers)
                if not woken.done():
                    woken.set_result(None)


@pytest.fixture
async def clock() -> AsyncIterator[VirtualClock]:
    clock = VirtualClock()
    running = asyncio.create_task(clock.run())
    yield clock
    running.cancel()
    with suppress(asyncio.CancelledError):
        await running


@pytest.fixture
async def cell(clock: VirtualClock) -> AsyncIterator[Mapping[str, Any]]:
    async with open_devices(("robot", "tracker", "pointer", "scene"), {}, clock) as devices:
        yield devices
