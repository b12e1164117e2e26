"""The event loop's alarm: a loop that is blocked is reported and counted."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator

import pytest
from structlog.testing import capture_logs

from pcmrs.clock import SystemClock
from pcmrs.messages import DeviceEvent
from pcmrs.service.watches.stall import PERIOD, STALL, StallWatch


class Bench:
    def __init__(self) -> None:
        self.events: list[DeviceEvent] = []
        self.told = asyncio.Event()
        self.watch = StallWatch(self._report, SystemClock())

    def _report(self, event: DeviceEvent) -> None:
        self.events.append(event)
        self.told.set()


@pytest.fixture
async def bench() -> AsyncIterator[Bench]:
    made = Bench()
    made.watch.start()
    yield made
    await made.watch.close()


async def test_blocked_loop_is_reported_and_is_no_danger(bench: Bench) -> None:
    """The deadman decides what is one."""
    await asyncio.sleep(4 * PERIOD)
    bench.events.clear()
    bench.told.clear()
    time.sleep(STALL + 0.2)  # noqa: ASYNC251  what nobody may do in a loop
    async with asyncio.timeout(20):
        await bench.told.wait()
    event = bench.events[0]
    assert (event.code, event.danger) == ("loop_stalled", False)
    assert event.fields["stall"] > STALL
    assert bench.watch.counters()["loop.stalls"] == len(bench.events)
    assert bench.watch.longest >= event.fields["stall"]


async def test_blocked_loop_is_logged_while_it_is_blocked(bench: Bench) -> None:
    """A loop that never answers again would otherwise say nothing."""
    with capture_logs() as logs:
        for _ in range(100):
            time.sleep(STALL)  # noqa: ASYNC251
            if logs:
                break
    assert logs[0]["event"] == "loop_stalled"
    assert "test_stall.py" in logs[0]["where"]
    assert bench.events == [], "the loop has not answered yet"
