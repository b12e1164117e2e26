"""When a surface does not help a registration: each check refuses beyond its limit, with the value and the remedy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import chi2

from pcmrs.errors import RefusalError
from pcmrs.registration import _surface_checks as checks
from pcmrs.spatial import Floats, Transform

CAP = np.radians(30.0)


def normals_within(angle: float) -> Floats:
    """Unit normals on a spherical cap, evenly spread about the z axis, (N, 3)."""
    turns, tilts = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False), np.linspace(0.0, angle, 12))
    x, y = np.sin(tilts) * np.cos(turns), np.sin(tilts) * np.sin(turns)
    return np.stack((x, y, np.cos(tilts)), axis=-1).reshape(-1, 3)


def step(sigmas: float) -> Callable[[], None]:
    """A motion along x by so many standard deviations of 2 mm."""
    covariance = np.diag((1e-4, 1e-4, 1e-4, 4e-6, 4e-6, 4e-6))
    motion = Transform(np.eye(3), np.array((sigmas * 0.002, 0.0, 0.0)))
    return lambda: checks.check_step(motion, covariance)


CASES: dict[str, tuple[Callable[[], None], Callable[[], None]]] = {
    "too_few_surface_points": (
        lambda: checks.check_count(25, checks.MIN_POINTS),
        lambda: checks.check_count(25, checks.MIN_POINTS - 1),
    ),
    "surface_far": (
        lambda: checks.check_near(np.full(9, 0.0039), np.full(9, 0.001)),
        lambda: checks.check_near(np.full(9, 0.0041), np.full(9, 0.001)),
    ),
    "surface_flat": (
        lambda: checks.check_curvature(normals_within(CAP)),
        lambda: checks.check_curvature(normals_within(CAP / 4.0)),
    ),
    "surface_step_too_large": (step(4.7), step(4.8)),
    "surface_offset_too_large": (
        lambda: checks.check_offset("hair", 0.008, 0.0001, 0.008),
        lambda: checks.check_offset("hair", 0.00801, 0.0001, 0.008),
    ),
    "surface_misfit": (lambda: checks.check_fit(0.002, 0.001), lambda: checks.check_fit(0.00201, 0.001)),
    "tre_not_lowered": (lambda: checks.check_gain(0.002, 0.00195), lambda: checks.check_gain(0.002, 0.00197)),
}


@pytest.mark.parametrize("code", CASES)
def test_each_check_refuses_just_beyond_its_limit(code: str) -> None:
    within, beyond = CASES[code]
    within()
    with pytest.raises(RefusalError) as refused:
        beyond()
    assert refused.value.refusal_code == code
    assert refused.value.fields


@pytest.mark.parametrize(
    ("region", "value", "words"),
    [("hair", 0.009, "in the hair are 9 ± 0.2 mm outside"), ("face", -0.0085, "on the face are 8.5 ± 0.2 mm inside")],
)
def test_offset_is_refused_with_place_side_and_deviation(region: str, value: float, words: str) -> None:
    with pytest.raises(RefusalError, match=words):
        checks.check_offset(region, value, 0.0002, 0.008)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_values_that_are_no_numbers_pass_no_check(bad: float) -> None:
    with pytest.raises(RefusalError, match="check that the mesh is this patient's"):
        checks.check_near(np.full(5, bad), np.full(5, 0.001))
    with pytest.raises(RefusalError, match="keep the landmarks' registration"):
        checks.check_gain(0.002, bad)
    with pytest.raises(RefusalError, match="part the hair"):
        checks.check_offset("everywhere", bad, 0.001, 0.008)


def test_half_of_the_points_decide_whether_the_start_is_near() -> None:
    """A few far points are outliers to trim, not a wrong mesh."""
    distances = np.concatenate((np.full(6, 0.001), np.full(5, 0.5)))
    checks.check_near(distances, np.full(11, 0.001))


def test_largest_step_is_the_quantile_that_is_stated() -> None:
    assert pytest.approx(chi2.ppf(0.999, 6), abs=0.005) == checks.MAX_STEP
