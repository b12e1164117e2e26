"""What a process takes is read rightly, and so is the line through it."""

from __future__ import annotations

import os
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs_lab.campaign.samples import descriptors, process_state, sample, slope

VALUES = st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=50)


@given(values=VALUES)
def test_the_line_is_that_of_numpy(values: list[float]) -> None:
    times = [float(number) for number in range(len(values))]
    found, _ = slope(times, values)
    assert found == pytest.approx(np.polyfit(times, values, 1)[0], abs=1e-6 * (1 + max(map(abs, values))))


def test_two_points_are_no_line() -> None:
    assert slope([0.0, 1.0], [0.0, 5.0]) == (0.0, 0.0)


def test_an_exact_line_has_no_error() -> None:
    assert slope([0.0, 1.0, 2.0], [1.0, 3.0, 5.0]) == (2.0, 0.0)
    assert slope([0.0, 1.0, 2.0, 3.0], [1.0, -1.0, 1.0, -1.0])[1] > 0.0


def test_descriptors_and_threads_are_counted() -> None:
    before = sample(os.getpid())
    reading, writing = os.pipe()
    end = threading.Event()
    thread = threading.Thread(target=end.wait)
    thread.start()
    after = sample(os.getpid())
    end.set()
    thread.join()
    assert descriptors(os.getpid()) == after.descriptors
    os.close(reading)
    os.close(writing)
    assert after.descriptors == before.descriptors + 2
    assert after.threads == before.threads + 1
    assert after.memory > 0


def test_the_state_of_a_process_is_that_of_the_kernel() -> None:
    assert process_state(os.getpid()) == "R"
    with pytest.raises(OSError, match="No such file"):
        sample(1 << 30)
