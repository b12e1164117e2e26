"""Lateness of a bare timer, and the percentile that a measurement beside it is compared with."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.simulated_time.loop import SimulatedLoop
from pcmrs.testing.loop import run_on_simulated_loop
from pcmrs_lab.campaign.lateness import PERIOD, percentile, timer_lateness


@given(
    values=st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=30), share=st.sampled_from([0.0, 0.5, 0.9, 0.99, 1.0])
)
def test_percentile_is_smallest_value_that_enough_do_not_exceed(values: list[float], share: float) -> None:
    assert percentile(values, share) == np.quantile(values, share, method="inverted_cdf")


@pytest.mark.parametrize(
    ("values", "share", "found"),
    [([], 0.5, 0.0), ([3.0], 0.99, 3.0), ([1.0, 2.0], 0.5, 1.0), (range(1, 7), 0.5, 3), (range(100), 0.99, 98)],
)
def test_a_median_of_an_even_number_is_the_lower_one(values: list[float], share: float, found: float) -> None:
    assert percentile(values, share) == found


def test_a_loop_that_is_held_up_makes_the_timer_late() -> None:
    async def measure() -> list[float]:
        loop = asyncio.get_running_loop()
        assert isinstance(loop, SimulatedLoop)
        async with timer_lateness() as timer:
            await asyncio.sleep(10 * PERIOD)
        return timer.late

    late = run_on_simulated_loop(measure())
    assert len(late) >= 9
    assert late == pytest.approx([0.0] * len(late), abs=1e-9)
