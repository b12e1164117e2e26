"""Digitizations of the simulated femur have the published residuals, and each published error is beyond the limit."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.registration import register_points
from pcmrs.spatial import Floats
from pcmrs_lab.experiment.published import PUBLISHED, FailureRun
from pcmrs_sim.femur import LANDMARKS

DEVIATION = 1.03e-3
"""Of a digitized landmark of the femur, m per axis."""
LIMIT = 2.7e-3
"""Residual that the workflow accepts, m."""
POINTS = np.array([landmark.position for landmark in LANDMARKS])


def residuals(offset: Floats, count: int) -> Floats:
    """Residuals of digitizations with an offset, m, (4, 3), (count,)."""
    rng = np.random.default_rng(0)
    touches = POINTS + offset + rng.normal(0.0, DEVIATION, (count, *POINTS.shape))
    return np.array([register_points(touched, POINTS).residual for touched in touches])


def test_usual_digitizations_have_the_published_residual() -> None:
    """They pass the limit."""
    controls = residuals(np.zeros((4, 3)), 2000)
    published = [run.residual_mm for run in PUBLISHED["femoroplasty"].failures if run.injection == "none"]
    assert min(filter(None, published)) < controls.mean() * 1e3 < max(filter(None, published))
    assert np.quantile(controls, 0.999) < LIMIT


@pytest.mark.parametrize("run", [run for run in PUBLISHED["femoroplasty"].failures if run.offset_in_image])
def test_every_published_digitization_error_is_beyond_the_limit(run: FailureRun) -> None:
    assert run.landmark is not None
    assert run.offset_in_image is not None
    offset = np.zeros((4, 3))
    offset[run.landmark - 1] = run.offset_in_image
    assert residuals(offset, 500).min() > 2 * LIMIT
