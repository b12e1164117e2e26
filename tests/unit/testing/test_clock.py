"""Clocks of tests: time passes only by `advance`, and whoever is due runs before it goes on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.clock import SystemClock
from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.testing.clock import EPOCH, ManualClock, SetClock, settle


@given(st.lists(st.floats(0.0, 100.0), min_size=1, max_size=6), st.lists(st.floats(0.0, 50.0), max_size=4))
def test_sleepers_wake_in_order_each_at_its_time(waits: list[float], steps: list[float]) -> None:
    async def course() -> None:
        clock, woken = ManualClock(), list[tuple[float, float]]()
        start = clock.monotonic()

        async def sleep(seconds: float) -> None:
            await clock.sleep(seconds)
            woken.append((start + seconds, clock.monotonic()))

        sleepers = [asyncio.create_task(sleep(seconds)) for seconds in waits]
        await settle()
        passed = 0.0
        for step in steps:
            passed += step
            await clock.advance(step)
            due = sorted(start + seconds for seconds in waits if start + seconds <= clock.monotonic())
            assert woken == [(each, each) for each in due]
            assert clock.monotonic() == pytest.approx(start + passed)
        for each in sleepers:
            each.cancel()
        await asyncio.gather(*sleepers, return_exceptions=True)

    asyncio.run(course())


@pytest.mark.parametrize("loop", [asyncio.new_event_loop, SimulatedLoop])
def test_settling_runs_a_chain_of_callbacks_to_its_end(loop: Callable[[], asyncio.AbstractEventLoop]) -> None:
    links = 30

    async def chain() -> int:
        reached = 0

        def link() -> None:
            nonlocal reached
            reached += 1
            if reached < links:
                asyncio.get_running_loop().call_soon(link)

        link()
        await settle()
        return reached

    with asyncio.Runner(loop_factory=loop) as runner:
        assert runner.run(chain()) == links


async def test_what_a_waiter_starts_runs_within_the_same_advance() -> None:
    clock, rung = ManualClock(), list[float]()

    async def ring() -> None:
        for _ in range(3):
            await clock.sleep(1.0)
            rung.append(clock.monotonic())

    ringing = asyncio.create_task(ring())
    await settle()
    await clock.advance(2.5)
    assert rung == [101.0, 102.0]
    await clock.advance(0.5)
    await ringing
    assert rung == [101.0, 102.0, 103.0]


async def test_a_deadline_ends_its_block_and_none_after_it() -> None:
    clock = ManualClock()

    async def wait(seconds: float) -> float:
        async with clock.timeout(5.0):
            await clock.sleep(seconds)
        await clock.sleep(10.0)
        return clock.monotonic()

    late, in_time = asyncio.create_task(wait(6.0)), asyncio.create_task(wait(4.0))
    await settle()
    await clock.advance(20.0)
    with pytest.raises(TimeoutError):
        await late
    assert await in_time == 114.0


async def test_a_stall_lets_time_pass_and_nobody_run() -> None:
    clock = ManualClock()
    sleeping = asyncio.create_task(clock.sleep(1.0))
    await settle()
    clock.stall(3.0)
    await settle()
    assert not sleeping.done()
    assert (clock.monotonic(), clock.wall()) == (103.0, EPOCH + 103.0)
    await clock.advance(0.0)
    assert sleeping.done()
    assert clock.monotonic() == 103.0


def test_a_wall_clock_that_is_set_leaves_the_monotonic_one_alone() -> None:
    true, clock = SystemClock(), SetClock()
    clock.ahead = -3600.0
    assert clock.wall() - true.wall() == pytest.approx(-3600.0, abs=5.0)
    assert clock.monotonic() - true.monotonic() == pytest.approx(0.0, abs=5.0)
