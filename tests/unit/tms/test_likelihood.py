"""The threshold by maximum likelihood, of responses with and without amplitudes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from pcmrs.tms.settings import ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator
from tests.support.trials import examples
from tests.unit.tms.hunts import hunted, muscle, yes_or_no


def brute_force(hunt: MotorThresholdEstimator) -> tuple[float, float, float]:
    """Yes and no only: prior times cumulative Gaussians."""
    prior = norm(hunt.settings.prior_mean, hunt.settings.prior_sd)
    grid = np.arange(4, 600) / 4.0
    density = prior.pdf(grid)
    for pulse in hunt.pulses:
        probability = norm.cdf(pulse.intensity, grid, 0.07 * grid)
        density *= probability if pulse.responded else 1.0 - probability
    shares = np.cumsum(density) / density.sum()
    return grid[np.argmax(density)], grid[np.argmax(shares >= 0.025)], grid[np.argmax(shares >= 0.975)]


@given(st.lists(st.tuples(st.integers(45, 75), st.booleans()), min_size=1, max_size=8))
@examples(15)
def test_the_estimate_is_the_maximum_of_the_likelihood(pulses: list[tuple[int, bool]]) -> None:
    hunt = MotorThresholdEstimator.begin(ThresholdSettings(interval=0.001, floor=1.0))
    for intensity, responded in pulses:
        if hunt.refusal is None:
            hunt = hunt.after(float(intensity), responded)
    best, low, high = brute_force(hunt)
    found = hunt.estimate
    assert found.threshold == pytest.approx(best, abs=0.26)
    assert found.low == pytest.approx(low, abs=0.26)
    assert found.high == pytest.approx(high, abs=0.26)


def test_amplitudes_tell_more_than_yes_and_no() -> None:
    seeds = range(40)
    with_amplitude = [len(hunted(ThresholdSettings(), muscle(60.0, seed)).pulses) for seed in seeds]
    without = [len(hunted(ThresholdSettings(), yes_or_no(muscle(60.0, seed))).pulses) for seed in seeds]
    assert np.median(with_amplitude) <= 17 < np.median(without)


def test_the_larger_the_response_the_lower_the_threshold() -> None:
    base = MotorThresholdEstimator.begin(ThresholdSettings())
    small, large = (base.after(60.0, True, amplitude).estimate.threshold for amplitude in (51e-6, 1e-3))
    none, almost = (base.after(60.0, False, amplitude).estimate.threshold for amplitude in (5e-6, 49e-6))
    assert large < small < none
    assert large < almost < none
    assert base.after(60.0, False, 1e-6).estimate == base.after(60.0, False, 20e-6).estimate  # both are noise
