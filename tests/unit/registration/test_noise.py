import math

import numpy as np
import pytest

from pcmrs.errors import GeometryError
from pcmrs.registration import NoiseEstimate, register_points, rms_spread
from tests.unit.registration.landmark_layouts import HEAD, HEAD_SIGMA, touched


def test_residuals_of_many_registrations_give_the_noise_per_axis() -> None:
    rng = np.random.default_rng(1)
    estimate = NoiseEstimate()
    for _ in range(500):
        estimate = estimate.with_residuals(register_points(touched(rng, HEAD, HEAD_SIGMA), HEAD).distances, len(HEAD))
    assert estimate.degrees == 500 * 12
    assert estimate.sigma(0.010, 1e-9) == pytest.approx(HEAD_SIGMA, rel=0.03)


def test_a_prior_counts_as_much_as_its_degrees() -> None:
    assert NoiseEstimate().sigma(0.002, 30.0) == pytest.approx(0.002)
    pooled = NoiseEstimate(sum_of_squares=10 * 0.004**2, degrees=10).sigma(0.002, 10.0)
    assert pooled == pytest.approx(math.sqrt((0.004**2 + 0.002**2) / 2))


@pytest.mark.parametrize(("distances", "count"), [([0.001, 0.001], 2), ([0.001, math.nan, 0.001], 3)])
def test_residuals_that_cannot_show_noise_are_refused(distances: list[float], count: int) -> None:
    with pytest.raises(GeometryError, match="say nothing of noise"):
        NoiseEstimate().with_residuals(distances, count)


def test_spread_is_the_rms_distance_from_the_mean() -> None:
    assert rms_spread([(0, 0, 0), (0.002, 0, 0)]) == pytest.approx(0.001)
    assert rms_spread([(1.0, 2.0, 3.0)]) == 0.0
    samples = np.random.default_rng(2).normal(scale=0.001, size=(4000, 3))
    assert rms_spread(samples + 5.0) == pytest.approx(0.001 * math.sqrt(3), rel=0.03)
    for wrong in (np.zeros((0, 3)), np.zeros(3), np.zeros((4, 2))):
        with pytest.raises(GeometryError, match="shape"):
            rms_spread(wrong)
