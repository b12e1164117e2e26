"""The loop in simulated time: time jumps, order is kept, and a deadlock is reported."""

from __future__ import annotations

import asyncio
from contextvars import copy_context
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.simulated_time.loop import OWNER, SimulatedLoop, SimulationError
from pcmrs.testing.loop import run_on_simulated_loop


@given(st.lists(st.floats(0.0, 1e6), min_size=1, max_size=20))
def test_all_sleepers_wake_at_the_exact_time_and_in_order(waits: list[float]) -> None:
    """Also where two are nearer to each other than any real timer could tell apart."""
    woken: list[tuple[float, float]] = []

    async def sleep(seconds: float) -> None:
        await asyncio.sleep(seconds)
        woken.append((seconds, asyncio.get_running_loop().time()))

    async def all_of_them() -> None:
        await asyncio.gather(*map(sleep, waits))

    run_on_simulated_loop(all_of_them())
    assert woken == [(seconds, seconds) for seconds in sorted(waits)]


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


def test_a_process_that_is_held_up_runs_later_and_others_do_not() -> None:
    """Its callbacks keep their order."""
    ran: list[tuple[str, float]] = []

    async def work(name: str, period: float) -> None:
        for _ in range(3):
            await asyncio.sleep(period)
            ran.append((name, asyncio.get_running_loop().time()))

    async def course() -> None:
        owned: dict[asyncio.Task[Any], None] = {}
        context = copy_context()
        context.run(OWNER.set, owned)
        loop = asyncio.get_running_loop()
        assert isinstance(loop, SimulatedLoop)
        slow = [asyncio.create_task(work(name, period), context=context) for name, period in (("a", 1.0), ("b", 1.5))]
        assert set(owned) == set(slow)
        free = asyncio.create_task(work("free", 1.0))
        await asyncio.sleep(0.5)
        loop.hold_up(owned, 2.0)
        await asyncio.gather(*slow, free)
        assert owned == {}

    run_on_simulated_loop(course())
    assert [each for each in ran if each[0] == "free"] == [("free", 1.0), ("free", 2.0), ("free", 3.0)]
    assert [each for each in ran if each[0] != "free"] == [
        ("a", 2.5),
        ("b", 2.5),
        ("a", 3.5),
        ("b", 4.0),
        ("a", 4.5),
        ("b", 5.5),
    ]


@given(st.integers(2, 30))
def test_a_set_of_tasks_has_the_same_order_in_every_run(count: int) -> None:
    """Whatever addresses the tasks have."""

    async def order() -> list[int]:
        tasks = [asyncio.create_task(asyncio.sleep(0, number)) for number in range(count)]
        return [await task for task in set(tasks)]

    first, padding = run_on_simulated_loop(order()), [object() for _ in range(count)]
    assert run_on_simulated_loop(order()) == first
    assert sorted(first) == list(range(len(padding)))


def test_a_cancelled_timer_neither_runs_nor_lets_time_pass() -> None:
    async def wait() -> float:
        loop, ran = asyncio.get_running_loop(), list[float]()
        loop.call_later(100.0, ran.append, 1.0).cancel()
        loop.call_at(2.0, ran.append, 2.0)
        loop.call_at(-5.0, ran.append, -5.0)  # what should have been earlier is due now
        await asyncio.sleep(3.0)
        assert ran == [-5.0, 2.0]
        return loop.time()

    assert run_on_simulated_loop(wait()) == 3.0


def test_a_socket_is_refused() -> None:
    """Time could not jump while something real is awaited."""

    async def connect() -> None:
        await asyncio.open_connection("127.0.0.1", 9)

    with pytest.raises((NotImplementedError, SimulationError)):
        run_on_simulated_loop(connect())
