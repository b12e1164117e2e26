"""The Kalman filter of constant velocity, against known motion and the theory of its steady state."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from pcmrs.spatial._constant_velocity import VelocityFilter
from pcmrs.spatial.prediction import TRANSLATION

RATE = 60.0


def test_the_error_is_as_large_as_the_covariance_says() -> None:
    """Monte Carlo with the acceleration that the filter assumes: mean squared error over variance is 1."""
    ratios = []
    spread = np.linalg.cholesky(np.array(((1 / RATE**3 / 3, 1 / RATE**2 / 2), (1 / RATE**2 / 2, 1 / RATE))))
    for seed in range(20):
        rng, tracked = np.random.default_rng(seed), VelocityFilter(TRANSLATION)
        position, rate = np.zeros(3), np.zeros(3)
        value = position + rng.normal(scale=TRANSLATION.measurement, size=3)
        for frame in range(180):
            disturbed = np.sqrt(TRANSLATION.rest) * spread @ rng.normal(size=(2, 3))
            position, rate = position + rate / RATE + disturbed[0], rate + disturbed[1]
            value = value + tracked.rate / RATE
            if frame > 60 and frame % 10 == 0:
                ratios.append((value - position) ** 2 / tracked.predicted_covariance(1 / RATE, TRANSLATION.rest)[0, 0])
            seen = position + rng.normal(scale=TRANSLATION.measurement, size=3)
            value = value + tracked.correct(1 / RATE, seen - value)
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


def test_gain_settles_at_that_of_the_riccati_equation() -> None:
    """Oracle: the stationary covariance of the filter, by SciPy."""
    step, elapsed = np.array(((1.0, 1 / RATE), (0.0, 1.0))), 1 / RATE
    spread = np.array(((elapsed**3 / 3, elapsed**2 / 2), (elapsed**2 / 2, elapsed)))
    seen = np.array(((1.0, 0.0),))
    expected = solve_discrete_are(step.T, seen.T, TRANSLATION.rest * spread, np.array([[TRANSLATION.measurement**2]]))
    tracked = VelocityFilter(TRANSLATION)
    for _ in range(2000):
        tracked.correct(elapsed, np.zeros(3))
    np.testing.assert_allclose(tracked.predicted_covariance(elapsed, TRANSLATION.rest), expected, rtol=1e-6)


def test_rate_becomes_that_of_uniform_motion() -> None:
    tracked, value, speed = VelocityFilter(TRANSLATION), np.zeros(3), np.array((0.01, -0.02, 0.0))
    for frame in range(1, 600):
        value = value + tracked.rate / RATE
        value = value + tracked.correct(1 / RATE, speed * frame / RATE - value)
    assert tracked.rate == pytest.approx(speed, abs=1e-5)


def test_uncertainty_grows_with_the_time_unseen_and_the_motion() -> None:
    tracked = VelocityFilter(TRANSLATION)
    for _ in range(100):
        tracked.correct(1 / RATE, np.zeros(3))
    variances = [tracked.predicted_covariance(time, TRANSLATION.rest)[0, 0] for time in (0.0, 0.02, 0.1, 0.5)]
    assert variances == sorted(variances)
    assert variances[0] < TRANSLATION.measurement**2, "what was measured often is known better than by one measurement"
    assert tracked.predicted_covariance(0.1, TRANSLATION.motion)[0, 0] > variances[2]


def test_an_outlier_is_more_than_any_motion_explains() -> None:
    tracked = VelocityFilter(TRANSLATION)
    for _ in range(100):
        tracked.correct(1 / RATE, np.zeros(3))
    variance = tracked.predicted_covariance(1 / RATE, TRANSLATION.motion)[0, 0] + TRANSLATION.measurement**2
    direction = np.array((0.0, 0.6, 0.8))
    for share, outlier in ((0.99, False), (1.01, True)):
        assert tracked.is_outlier(5.0, 1 / RATE, share * 5.0 * np.sqrt(variance) * direction) == outlier


def test_a_frame_that_shows_motion_is_followed_at_once() -> None:
    """The same share of a small innovation would be taken for noise."""
    shares = []
    for size in (1e-5, 1e-3):
        tracked = VelocityFilter(TRANSLATION)
        for _ in range(100):
            tracked.correct(1 / RATE, np.zeros(3))
        shares.append(tracked.correct(1 / RATE, np.array((size, 0.0, 0.0)))[0] / size)
    assert shares[0] < 0.5 < shares[1] <= 1.0
