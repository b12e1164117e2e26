"""The event loop's alarm: a loop that is blocked is told of, counted, and danger where something moves."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator

import pytest

from pcmrs.clock import SystemClock
from pcmrs.messages import DeviceEvent
from pcmrs.service.watches.stall import PERIOD, STALL, StallWatch


class Bench:
    def __init__(self, deadman: float = 0.1) -> None:
        self.events: list[DeviceEvent] = []
        self.told = asyncio.Event()
        self.moving = False
        self.watch = StallWatch(self._report, lambda: self.moving, SystemClock(), deadman)

    def _report(self, event: DeviceEvent) -> None:
        self.events.append(event)
        self.told.set()


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench()
    made.watch.start()
    yield made
    await made.watch.close()


@pytest.mark.parametrize("moving", [False, True])
async def test_blocked_loop_is_reported_and_is_danger_during_a_motion(bench: Bench, moving: bool) -> None:
    bench.moving = moving
    await asyncio.sleep(4 * PERIOD)  # it has asked before: so it knows what moved before the stall
    bench.events.clear()
    bench.told.clear()
    time.sleep(STALL + 0.2)  # noqa: ASYNC251  what nobody may do in a loop
    bench.moving = False
    async with asyncio.timeout(20):
        await bench.told.wait()
    event = bench.events[0]
    assert (event.code, event.danger) == ("loop_stalled", moving)
    assert event.fields["stall"] > STALL
    assert bench.watch.counters()["loop.stalls"] == len(bench.events)
    assert bench.watch.longest >= event.fields["stall"]


async def test_a_stall_that_the_deadman_permits_is_no_danger() -> None:
    bench = Bench(deadman=60.0)
    bench.moving = True
    bench.watch.start()
    try:
        await asyncio.sleep(4 * PERIOD)
        time.sleep(STALL + 0.2)  # noqa: ASYNC251
        async with asyncio.timeout(20):
            await bench.told.wait()
    finally:
        await bench.watch.close()
    assert [(event.code, event.danger) for event in bench.events] == [("loop_stalled", False)] * len(bench.events)
