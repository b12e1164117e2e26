"""Poses that turn too little, or do not fit the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcmrs.errors import DegenerateMotionError, RefusalError
from pcmrs.registration.pivot import _Fit, _fit
from pcmrs.registration.pose_sets import MIN_TURN, check_count, check_rotation_spread, without_bad_poses
from pcmrs.spatial import Floats
from tests.unit.registration.pivot_poses import NOISE, poses_about, shifted


def test_of_poses_that_nothing_checks_none_is_suspected() -> None:
    """Three poses have as many equations left as there are parameters: the residuals say nothing of the noise."""
    poses = shifted(poses_about(np.random.default_rng(9), 3, NOISE), [1], 0.05)
    rotations, positions = np.array([p.rotation for p in poses]), np.array([p.translation for p in poses])

    def fit_to(chosen: list[int]) -> _Fit:
        return _fit(rotations[chosen], positions[chosen])

    found, good, bad = without_bad_poses(3, fit_to)
    assert (good, bad) == ([0, 1, 2], ())
    assert np.array_equal(found.solution, fit_to([0, 1, 2]).solution)


def turned(*axes: tuple[float, float, float]) -> np.ndarray:
    """Rotations by up to 40° about each of the axes, (N, 3, 3)."""
    angles = np.radians(np.linspace(-40.0, 40.0, 9))
    return np.array([Rotation.from_rotvec(angle * np.array(axis)).as_matrix() for axis in axes for angle in angles])


def test_rotations_about_one_axis_are_refused_with_the_axis() -> None:
    check_rotation_spread(turned((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)), "pointer", "tilt it")
    with pytest.raises(DegenerateMotionError, match=r"turn about the axis .* only.*tilt it") as refused:
        check_rotation_spread(turned((0.0, 0.6, 0.8)), "pointer", "tilt it")
    assert np.abs(refused.value.fields["axis"]) == pytest.approx((0.0, 0.6, 0.8), abs=1e-9)
    assert refused.value.fields["singular_values"][2] < refused.value.fields["limit"] == MIN_TURN
    with pytest.raises(DegenerateMotionError, match="hardly turn at all"):
        check_rotation_spread(np.tile(np.eye(3), (5, 1, 1)), "pointer", "tilt it")


def test_too_few_poses_are_refused_with_the_least_number() -> None:
    check_count(4, 4, "take more")
    with pytest.raises(DegenerateMotionError, match="3 poses are too few, at least 4 are needed") as refused:
        check_count(3, 4, "take more")
    assert refused.value.fields == {"count": 3, "limit": 4}


@dataclass(frozen=True)
class Mean:
    """Fit of one point to measurements: the simplest fit to poses."""

    residuals: Floats
    jacobian: Floats
    smallest_noise: float = 1e-9


def mean_of(points: Floats) -> Callable[[list[int]], Mean]:
    def fit(chosen: list[int]) -> Mean:
        return Mean(points[chosen] - points[chosen].mean(axis=0), -np.tile(np.eye(3), (len(chosen), 1, 1)))

    return fit


@pytest.mark.parametrize("bad", [[3], [0, 17], [2, 9, 19]])
def test_measurements_far_from_the_others_are_left_out(bad: list[int]) -> None:
    points = np.random.default_rng(3).normal(0.0, 0.001, (20, 3))
    points[bad] += 0.05 * np.eye(3)[: len(bad)]
    _, good, found = without_bad_poses(20, mean_of(points))
    assert found == tuple(bad)
    assert sorted([*good, *bad]) == list(range(20))


def test_good_sets_seldom_lose_a_measurement() -> None:
    """Each of two tests may suspect one set in a hundred."""
    rng = np.random.default_rng(4)
    lost = sum(bool(without_bad_poses(12, mean_of(rng.normal(size=(12, 3))))[2]) for _ in range(300))
    assert lost <= 15  # 2 % of 300 are 6; more than 15 have a probability below 0.1 %


def test_too_many_bad_measurements_are_refused_and_numbered() -> None:
    points = np.random.default_rng(5).normal(0.0, 0.001, (20, 3))
    points[:6] += 10.0 ** np.arange(6)[:, None] * np.array((1.0, -0.5, 0.2))
    with pytest.raises(RefusalError, match="look for what moved") as refused:
        without_bad_poses(20, mean_of(points))
    assert refused.value.refusal_code == "too_many_bad_poses"
    assert set(refused.value.fields["bad"]) <= set(range(6))
