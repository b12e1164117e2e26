"""Clocks in simulated time: deadlines, and wall clocks that are set."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.simulated_time.clock import EPOCH, SimulatedClock
from pcmrs.simulated_time.loop import SimulatedLoop, SimulationError
from pcmrs.testing.loop import run_on_simulated_loop


def test_a_day_takes_no_time_and_a_deadline_is_met() -> None:
    async def wait_for_ever() -> float:
        clock = SimulatedClock(asyncio.get_running_loop())
        with pytest.raises(TimeoutError):
            async with clock.timeout(86400.0):
                await asyncio.get_running_loop().create_future()
        return clock.monotonic()

    assert run_on_simulated_loop(wait_for_ever()) == 86400.0


def test_set_or_stopped_wall_clock_does_not_affect_deadlines() -> None:
    async def look() -> list[float]:
        clock = SimulatedClock(asyncio.get_running_loop())
        await clock.sleep(10.0)
        clock.ahead = -3600.0
        seen = [clock.wall() - EPOCH]
        clock.freeze(True)
        await clock.sleep(5.0)
        seen.append(clock.wall() - EPOCH)
        clock.freeze(False)
        return [*seen, clock.wall() - EPOCH, clock.monotonic()]

    assert run_on_simulated_loop(look()) == [-3590.0, -3590.0, -3585.0, 15.0]


@given(st.lists(st.floats(-10.0, 1e5), min_size=1, max_size=8))
def test_clocks_of_one_loop_share_their_monotonic_time(waits: list[float]) -> None:
    """A wait of less than nothing takes no time."""

    async def wait() -> list[float]:
        one, other = (SimulatedClock(asyncio.get_running_loop()) for _ in range(2))
        other.ahead, seen = 60.0, []
        for seconds in waits:
            await one.sleep(seconds)
            assert one.monotonic() == other.monotonic()
            assert other.wall() - one.wall() == 60.0
            seen.append(other.monotonic())
        return seen

    expected, now = [], 0.0
    for seconds in waits:
        now += max(0.0, seconds)
        expected.append(now)
    assert run_on_simulated_loop(wait()) == expected


def test_a_cancelled_wait_leaves_no_timer_behind() -> None:
    """Time would jump to it when nothing else is due."""

    async def wait() -> None:
        clock = SimulatedClock(asyncio.get_running_loop())
        waiting = asyncio.create_task(clock.sleep(1000.0))
        await clock.sleep(1.0)
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        await asyncio.get_running_loop().create_future()

    loop = SimulatedLoop()
    task = loop.create_task(wait())
    with pytest.raises(SimulationError, match="no timer is set"):
        loop.run_until_complete(task)
    assert loop.time() == 1.0
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        loop.run_until_complete(task)
    loop.close()


def test_a_deadline_that_is_kept_does_not_interrupt_later() -> None:
    async def wait() -> float:
        clock = SimulatedClock(asyncio.get_running_loop())
        async with clock.timeout(5.0):
            await clock.sleep(4.0)
        await clock.sleep(10.0)
        return clock.monotonic()

    assert run_on_simulated_loop(wait()) == 14.0
