"""The loop on which everything is simulated: time jumps, order is kept, and what never ends is told."""

from __future__ import annotations

import asyncio
import uuid
from collections.abc import Awaitable
from typing import TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.simulated_time.clock import EPOCH, SimulatedClock
from pcmrs.simulated_time.loop import SimulatedLoop, SimulationError
from pcmrs_sim.deterministic.entropy import seeded_entropy

T = TypeVar("T")


def simulated(work: Awaitable[T]) -> T:
    """Runs `work` on a loop of its own."""
    loop = SimulatedLoop()
    try:
        return loop.run_until_complete(work)
    finally:
        loop.close()


@given(st.lists(st.floats(0.0, 1e6), min_size=1, max_size=20))
def test_all_sleepers_wake_at_the_exact_time_and_in_order(waits: list[float]) -> None:
    """Also where two are nearer to each other than any real timer could tell apart."""
    woken: list[tuple[float, float]] = []

    async def sleep(seconds: float) -> None:
        await asyncio.sleep(seconds)
        woken.append((seconds, asyncio.get_running_loop().time()))

    async def all_of_them() -> None:
        await asyncio.gather(*map(sleep, waits))

    simulated(all_of_them())
    assert woken == [(seconds, seconds) for seconds in sorted(waits)]


def test_a_day_takes_no_time_and_a_deadline_is_met() -> None:
    async def wait_for_ever() -> float:
        clock = SimulatedClock(asyncio.get_running_loop())
        with pytest.raises(TimeoutError):
            async with clock.timeout(86400.0):
                await asyncio.get_running_loop().create_future()
        return clock.monotonic()

    assert simulated(wait_for_ever()) == 86400.0


def test_waiting_for_nothing_is_an_error() -> None:
    async def wait() -> None:
        await asyncio.get_running_loop().create_future()

    loop = SimulatedLoop()
    task = loop.create_task(wait())
    with pytest.raises(SimulationError, match="no timer is set"):
        loop.run_until_complete(task)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        loop.run_until_complete(task)
    loop.close()


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

    assert simulated(look()) == [-3590.0, -3590.0, -3585.0, 15.0]


def test_identifiers_are_drawn_from_the_seed_and_only_meanwhile() -> None:
    with seeded_entropy(7):
        first = uuid.uuid4()
    with seeded_entropy(7):
        assert uuid.uuid4() == first
    assert uuid.uuid4() != first
