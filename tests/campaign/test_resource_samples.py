"""What a process takes is read rightly, and what grows is told from what only wavers."""

from __future__ import annotations

import os
import random
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.campaign.samples import sample, slope
from pcmrs.campaign.soaking import ALLOWED, course

VALUES = st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=50)


@given(values=VALUES)
def test_the_line_is_that_of_numpy(values: list[float]) -> None:
    times = [float(number) for number in range(len(values))]
    found, _ = slope(times, values)
    assert found == pytest.approx(np.polyfit(times, values, 1)[0], abs=1e-6 * (1 + max(map(abs, values))))


def test_descriptors_and_threads_are_counted() -> None:
    before = sample(os.getpid())
    reading, writing = os.pipe()
    end = threading.Event()
    thread = threading.Thread(target=end.wait)
    thread.start()
    after = sample(os.getpid())
    end.set()
    thread.join()
    os.close(reading)
    os.close(writing)
    assert after.descriptors == before.descriptors + 2
    assert after.threads == before.threads + 1
    assert after.memory > 0


@pytest.mark.parametrize("measure", ALLOWED)
@given(seed=st.integers(0, 100))
def test_what_wavers_is_flat_and_what_grows_is_not(measure: str, seed: int) -> None:
    generator = random.Random(seed)
    allowed = ALLOWED[measure]
    times = [float(number) for number in range(200)]
    wavering = [10 * allowed + generator.gauss(0.0, allowed / 4) for _ in times]
    growing = [value + 3 * allowed * time / times[-1] for time, value in zip(times, wavering, strict=True)]
    assert course("daemon", measure, times, wavering).flat
    assert not course("daemon", measure, times, growing).flat


def test_what_grows_only_while_it_warms_up_is_flat() -> None:
    times = [float(number) for number in range(100)]
    values = [1e8 + min(time, 15.0) * 4e6 for time in times]
    assert course("daemon", "memory", times, values).flat
