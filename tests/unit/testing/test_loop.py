"""A coroutine in simulated time: its result, its errors, and waits that cost nothing."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.simulated_time.clock import SimulatedClock
from pcmrs.simulated_time.loop import SimulatedLoop, SimulationError
from pcmrs.testing.loop import run_on_simulated_loop


async def wait(seconds: float) -> tuple[float, asyncio.AbstractEventLoop]:
    loop = asyncio.get_running_loop()
    await SimulatedClock(loop).sleep(seconds)
    return loop.time(), loop


def test_each_run_has_its_own_loop_that_starts_at_zero() -> None:
    first, first_loop = run_on_simulated_loop(wait(86_400.0))
    second, second_loop = run_on_simulated_loop(wait(0.5))
    assert (first, second) == (86_400.0, 0.5)
    assert isinstance(first_loop, SimulatedLoop)
    assert first_loop is not second_loop
    assert first_loop.is_closed()


def test_an_error_is_raised_and_its_loop_is_closed() -> None:
    loops: list[asyncio.AbstractEventLoop] = []

    async def fail() -> None:
        loops.append((await wait(1.0))[1])
        raise KeyError("missing")

    with pytest.raises(KeyError, match="missing"):
        run_on_simulated_loop(fail())
    assert loops[0].is_closed()


def test_work_that_waits_for_nothing_is_reported_at_once() -> None:
    async def wait_for_nothing() -> None:
        await asyncio.get_running_loop().create_future()

    with pytest.raises(SimulationError, match="no timer is set"):
        run_on_simulated_loop(wait_for_nothing())
