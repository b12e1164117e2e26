"""Beats keep their rate; missed ones are dropped, and no timer is left behind."""

from __future__ import annotations

import asyncio
import errno
import math
import resource
import time
from contextlib import aclosing
from pathlib import Path

import numpy as np
import pytest

from pcmrs.background import BackgroundTasks
from pcmrs.gateway.periodic_timer import PeriodicTask, beats_of, kernel_beats
from tests.unit.gateway.gateway_fakes import ManualClock


def open_files() -> list[str]:
    return sorted(each.name for each in Path("/proc/self/fd").iterdir())


async def test_ticks_missed_in_a_stall_are_not_made_up_for() -> None:
    clock, tasks, times = ManualClock(), BackgroundTasks(), []
    enough = asyncio.Event()

    def tick() -> None:
        times.append(clock.now)
        clock.now += 1.0 if len(times) == 2 else 0.0
        if len(times) == 8:
            enough.set()

    repetition = PeriodicTask(beats_of(clock), 10.0, tick, tasks)
    repetition.start()
    await enough.wait()
    repetition.stop()
    await tasks.close()
    assert times[2] == pytest.approx(times[1] + 1.0), "the stall is over"
    assert np.diff(times[2:8]) == pytest.approx(0.1)


async def test_real_time_beats_keep_their_rate_and_missed_ones_are_one() -> None:
    period, missed = 0.01, 20
    began, count = time.monotonic(), 0
    async with aclosing(kernel_beats(period)) as beats:
        async for _ in beats:
            count += 1
            if count == 5:
                time.sleep((missed + 1) * period)  # noqa: ASYNC251 (a loop that is busy elsewhere)
            if count == 10:
                break
    assert time.monotonic() - began > (count - 2 + missed) * period


async def test_beats_that_end_leave_no_timer_behind() -> None:
    before = open_files()
    tasks = BackgroundTasks()
    repetition = PeriodicTask(kernel_beats, 1000.0, lambda: None, tasks)
    for _ in range(3):
        repetition.start()
        await asyncio.sleep(0.01)
        repetition.stop()
        await tasks.close()
    assert open_files() == before


async def test_where_no_timer_can_be_made_the_beats_say_so() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (0, hard))
    try:
        with pytest.raises(OSError, match="timerfd") as failed:
            await anext(kernel_beats(0.01))
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert failed.value.errno == errno.EMFILE


async def test_rate_beyond_the_timer_does_not_end_the_beats() -> None:
    async with asyncio.timeout(30.0), aclosing(kernel_beats(1.0 / math.inf)) as beats:
        for _ in range(3):
            await anext(beats)
