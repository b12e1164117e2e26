"""The clock of a cell: shared by the processes of a machine, and as much faster as its rate says."""

from __future__ import annotations

import asyncio
import time

import pytest

from pcmrs.clock import SystemClock

RATE = 20.0


@pytest.mark.parametrize("rate", [1.0, RATE])
def test_clocks_of_one_rate_have_the_same_time(rate: float) -> None:
    """Ages of messages are differences of two processes' clocks."""
    before = time.monotonic()
    here, there = SystemClock(rate).monotonic(), SystemClock(rate).monotonic()
    after = time.monotonic()
    assert before * rate <= here <= there <= after * rate


async def test_waits_are_shorter_by_the_rate() -> None:
    clock, began = SystemClock(RATE), time.monotonic()
    before = clock.monotonic()
    await clock.sleep(1.0)
    assert time.monotonic() - began >= 1.0 / RATE - 1e-3
    assert clock.monotonic() - before >= 1.0 - RATE * 1e-3


async def test_a_wait_that_is_over_already_does_not_fail() -> None:
    await SystemClock().sleep(-1.0)


async def test_deadline_passes_in_the_time_of_the_clock() -> None:
    began = time.monotonic()
    with pytest.raises(TimeoutError):
        async with SystemClock(rate=1000.0).timeout(60.0):
            await asyncio.Event().wait()
    assert 0.06 - 1e-3 <= time.monotonic() - began < 60.0


def test_wall_time_is_not_faster() -> None:
    """Files and certificates of a simulated cell have the time of the machine."""
    assert abs(SystemClock(RATE).wall() - time.time()) < 5.0
