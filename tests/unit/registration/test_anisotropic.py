"""With the covariances of the points, the most likely motion is found."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pcmrs.errors import GeometryError
from pcmrs.registration import register_points
from pcmrs.registration._anisotropic import MAX_STEPS, fit_anisotropic
from pcmrs.registration.rigid import fit_rigid
from pcmrs.spatial import Transform
from tests.unit.registration.random_sets import random_motion, random_points, seeds


def random_covariances(rng: np.random.Generator, count: int) -> np.ndarray:
    """Deviations of 0.5 to 2 mm along axes that are turned anyhow."""
    axes = Rotation.random(count, rng=rng).as_matrix() * rng.uniform(0.0005, 0.002, (count, 1, 3))
    return axes @ axes.swapaxes(1, 2)


@given(seeds, st.integers(4, 10))
def test_with_covariances_the_most_likely_motion_is_found(seed: int, count: int) -> None:
    """Oracle: SciPy's general least squares on the whitened differences."""
    rng = np.random.default_rng(seed)
    moving, truth, covariances = random_points(rng, count), random_motion(rng), random_covariances(rng, count)
    fixed = truth @ moving + np.array([rng.multivariate_normal(np.zeros(3), c) for c in covariances])
    whiten = np.linalg.inv(np.linalg.cholesky(covariances))

    def left(motion: np.ndarray) -> np.ndarray:
        moved = Transform.from_rotvec(motion[3:], motion[:3]) @ (truth @ moving)
        return np.ravel(np.einsum("nij,nj->ni", whiten, moved - fixed))

    expected = least_squares(left, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=0.01)
    found = register_points(fixed, moving, covariances=covariances)
    motion = found.fixed_from_moving @ truth.inverse()
    cost = 0.5 * np.sum(left(np.concatenate((motion.rotvec, motion.translation))) ** 2)
    assert cost <= expected.cost * (1 + 1e-9)
    np.testing.assert_allclose(motion.rotvec, expected.x[:3], atol=1e-6)


@given(seeds, st.floats(1e-4, 1e-2))
def test_equal_covariances_change_nothing(seed: int, sigma: float) -> None:
    rng = np.random.default_rng(seed)
    moving = random_points(rng, 6)
    fixed = random_motion(rng) @ moving + rng.normal(scale=0.002, size=moving.shape)
    plain = register_points(fixed, moving)
    equal = register_points(fixed, moving, covariances=np.tile(sigma**2 * np.eye(3), (6, 1, 1)))
    np.testing.assert_allclose(equal.fixed_from_moving.matrix, plain.fixed_from_moving.matrix, atol=1e-10)


def test_points_that_nothing_settles_are_refused_with_the_step() -> None:
    """Four points that are known along one axis each, and do not fit."""
    rng = np.random.default_rng(0)
    moving = 0.1 * rng.normal(size=(4, 3))
    fixed = moving + rng.normal(scale=0.1, size=(4, 3))
    axes = np.linalg.qr(rng.normal(size=(4, 3, 3)))[0]
    covariances = axes @ (10.0 ** rng.uniform(-8, 0, (4, 3, 1)) * np.eye(3)) @ axes.swapaxes(1, 2)
    with pytest.raises(GeometryError, match="did not settle in 100 steps") as refused:
        fit_anisotropic(fixed, moving, covariances, fit_rigid(fixed, moving))
    assert refused.value.fields["steps"] == MAX_STEPS


@given(seeds)
def test_inverse_covariances_weigh_a_sharp_axis_most(seed: int) -> None:
    """A point known along one axis only moves the fit along that axis only."""
    rng = np.random.default_rng(seed)
    moving = random_points(rng, 5)
    covariances = np.tile(1e-6 * np.eye(3), (5, 1, 1))
    covariances[3] = np.diag((1e-6, 1e6, 1e6))
    fixed, loose = moving.copy(), moving.copy()
    loose[3] += (0.0, 0.02, -0.03)
    exact = fit_anisotropic(fixed, moving, covariances, fit_rigid(fixed, moving))
    moved = fit_anisotropic(loose, moving, covariances, fit_rigid(loose, moving))
    np.testing.assert_allclose(moved.matrix, exact.matrix, atol=1e-6)
