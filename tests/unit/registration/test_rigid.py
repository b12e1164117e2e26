"""Rigid fits in closed form, of one set and of many at once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.registration import register_batch, register_points
from pcmrs.registration.rigid import cross_matrices, fit_rigid, motion_jacobians, sums_of_squares
from pcmrs.spatial import Transform
from tests.unit.registration.random_sets import SQUARE, random_motion, random_points, seeds


@pytest.mark.parametrize("one_moving", [True, False])
def test_a_batch_is_the_same_fit_many_times(one_moving: bool) -> None:
    rng = np.random.default_rng(8)
    sets = np.array([SQUARE if n % 3 == 0 else random_points(rng, 4) for n in range(60)])
    fixed = sets + rng.normal(scale=0.002, size=sets.shape)
    moving = sets[1] if one_moving else sets
    if one_moving:
        fixed = moving + rng.normal(scale=0.002, size=sets.shape)
    rotations, translations = register_batch(fixed, moving)
    for n in range(60):
        single = register_points(fixed[n], moving if one_moving else moving[n]).fixed_from_moving
        np.testing.assert_allclose(rotations[n], single.rotation, atol=1e-9)
        np.testing.assert_allclose(translations[n], single.translation, atol=1e-9)


@given(seeds, st.integers(3, 10))
def test_no_small_motion_improves_the_fit(seed: int, count: int) -> None:
    """The necessary condition of a least sum of squares, in all six directions."""
    rng = np.random.default_rng(seed)
    moving = random_points(rng, count)
    fixed = random_motion(rng) @ moving + rng.normal(scale=0.01, size=moving.shape)
    fit = fit_rigid(fixed, moving)
    least = float(np.sum(fit.squares()))
    best = Transform(fit.rotation, fit.translation)
    for direction in np.concatenate((np.eye(6), -np.eye(6))) * 1e-3:
        nearby = Transform.from_rotvec(direction[3:], direction[:3]) @ best
        assert np.sum((nearby @ moving - fixed) ** 2) >= least - 1e-12
    assert sums_of_squares(fixed[None], moving)[0] == pytest.approx(least)


@given(seeds)
def test_a_reflection_is_never_returned(seed: int) -> None:
    rng = np.random.default_rng(seed)
    moving = random_points(rng, 5)
    fixed = moving * (-1.0, 1.0, 1.0) + rng.normal(scale=1e-3, size=moving.shape)
    fit = fit_rigid(fixed, moving)
    assert np.linalg.det(fit.rotation) == pytest.approx(1.0)
    assert fit.smallest < 0.0


@given(seeds)
def test_jacobians_are_those_of_a_small_motion(seed: int) -> None:
    """Oracle: differences of moved points."""
    rng = np.random.default_rng(seed)
    points, motion, size = rng.normal(size=(4, 3)), rng.normal(size=6), 1e-6
    ahead = Transform.from_rotvec(size * motion[3:], size * motion[:3]) @ points
    back = Transform.from_rotvec(-size * motion[3:], -size * motion[:3]) @ points
    np.testing.assert_allclose(motion_jacobians(points) @ motion, (ahead - back) / (2.0 * size), atol=1e-7)
    vectors = rng.normal(size=(4, 3))
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", cross_matrices(points), vectors), np.cross(points, vectors), atol=1e-12
    )
