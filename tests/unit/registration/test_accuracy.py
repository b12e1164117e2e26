"""The predicted error against what happens: thousands of noisy registrations, never a copied formula."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcmrs.errors import DegeneratePointsError, GeometryError
from pcmrs.registration import predict_tre, register_batch, register_points
from pcmrs.spatial import Floats
from tests.unit.registration.landmark_layouts import FEMUR, HEAD, VERTEX

RUNS = 20_000
OBLIQUE = Rotation.from_rotvec((0.7, -0.4, 0.9)).as_matrix()
"""Principal axes along no axis of the frame: a formula that mixes rows and columns of eigenvectors fails here."""
LAYOUTS = {
    "head": HEAD,
    "femur": FEMUR,
    "flat": 0.1 * np.array([(0, 0, 0), (1.5, 0, 0), (1.5, 1, 0), (0, 1, 0)], dtype=float),
    "triangle": np.array([(0.0, 0.0, 0.0), (0.12, 0.0, 0.0), (0.03, 0.06, 0.0)]),
    "long": np.array([(0, 0, 0), (0.3, 0.01, 0), (0.15, 0.05, 0.02), (0.1, -0.04, 0.03), (0.25, 0, -0.05)]),
}
TARGETS = np.array([(0.0, 0.0, 0.1), (0.05, -0.08, 0.02), (0.02, 0.01, 0.0), (-0.2, 0.1, 0.1)])


def measured_tre(rotations: Floats, translations: Floats, targets: Floats) -> Floats:
    off = targets @ rotations.swapaxes(1, 2) + translations[:, None] - targets
    rms: Floats = np.sqrt(np.mean(np.sum(off**2, axis=2), axis=0))
    return rms


def unequal(rng: np.random.Generator, count: int) -> Floats:
    """As an optical tracker's: three times the noise along one direction, and landmarks of different quality."""
    axes = Rotation.random(rng=rng).as_matrix() * np.array((0.0004, 0.0004, 0.0012))
    covariances: Floats = (axes @ axes.T) * rng.uniform(0.5, 2.0, (count, 1, 1))
    return covariances


def noisy(rng: np.random.Generator, points: Floats, covariances: Floats, runs: int) -> Floats:
    roots = np.linalg.cholesky(covariances)
    moved: Floats = points + np.einsum("nij,bnj->bni", roots, rng.normal(size=(runs, len(points), 3)))
    return moved


@pytest.mark.parametrize("layout", LAYOUTS)
def test_equal_noise(layout: str) -> None:
    fiducials, targets = LAYOUTS[layout] @ OBLIQUE.T, TARGETS @ OBLIQUE.T
    rng = np.random.default_rng(5)
    fits = register_batch(fiducials + rng.normal(scale=0.0005, size=(RUNS, *fiducials.shape)), fiducials)
    np.testing.assert_allclose(predict_tre(fiducials, targets, 0.0005), measured_tre(*fits, targets), rtol=0.02)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_unequal_noise_that_the_fit_does_not_know(layout: str) -> None:
    fiducials, targets = LAYOUTS[layout] @ OBLIQUE.T, TARGETS @ OBLIQUE.T
    rng = np.random.default_rng(6)
    covariances = unequal(rng, len(fiducials))
    fits = register_batch(noisy(rng, fiducials, covariances, RUNS), fiducials)
    predicted = predict_tre(fiducials, targets, covariances, weights=np.ones(len(fiducials)))
    np.testing.assert_allclose(predicted, measured_tre(*fits, targets), rtol=0.02)


@pytest.mark.parametrize("layout", ["head", "femur"])
def test_unequal_noise_that_the_fit_knows(layout: str) -> None:
    fiducials, targets = LAYOUTS[layout] @ OBLIQUE.T, TARGETS @ OBLIQUE.T
    rng = np.random.default_rng(7)
    covariances = unequal(rng, len(fiducials))
    runs = 2000
    fits = [
        register_points(fixed, fiducials, covariances=covariances).fixed_from_moving
        for fixed in noisy(rng, fiducials, covariances, runs)
    ]
    measured = measured_tre(
        np.array([fit.rotation for fit in fits]), np.array([fit.translation for fit in fits]), targets
    )
    predicted = predict_tre(fiducials, targets, covariances)
    np.testing.assert_allclose(predicted, measured, rtol=0.04)  # 2,000 runs: 1.5 % of sampling error
    assert (predicted <= predict_tre(fiducials, targets, covariances, weights=np.ones(len(fiducials)))).all()


def test_weights_of_the_fit() -> None:
    weights = np.array([1.0, 2.0, 0.5, 0.0, 1.0, 3.0])
    rng = np.random.default_rng(9)
    fits = [
        register_points(HEAD + rng.normal(scale=0.0005, size=HEAD.shape), HEAD, weights=weights).fixed_from_moving
        for _ in range(5000)
    ]
    measured = measured_tre(
        np.array([fit.rotation for fit in fits]), np.array([fit.translation for fit in fits]), TARGETS
    )
    np.testing.assert_allclose(predict_tre(HEAD, TARGETS, 0.0005, weights=weights), measured, rtol=0.03)


def test_equal_noise_is_fitzpatricks_formula() -> None:
    """TRE^2 = FLE^2 / N (1 + 1/3 sum d_k^2 / f_k^2), distances about the principal axes."""
    centred = HEAD - HEAD.mean(axis=0)
    axes = np.linalg.svd(centred)[2]
    local, target = centred @ axes.T, (VERTEX - HEAD.mean(axis=0)) @ axes.T
    ratios = [
        (target @ target - target[k] ** 2) / np.mean(np.sum(local**2, axis=1) - local[:, k] ** 2) for k in range(3)
    ]
    expected = 0.00186 * np.sqrt(3 / len(HEAD) * (1 + sum(ratios) / 3))
    assert predict_tre(HEAD, VERTEX, 0.00186) == pytest.approx([expected])


def test_residual_and_target_error_are_uncorrelated() -> None:
    """Why the residual alone is no gate: J. M. Fitzpatrick, SPIE Medical Imaging 2009."""
    rng = np.random.default_rng(4)
    fixed = HEAD + rng.normal(scale=0.00186, size=(4000, *HEAD.shape))
    rotations, translations = register_batch(fixed, HEAD)
    residuals = np.linalg.norm(HEAD @ rotations.swapaxes(1, 2) + translations[:, None] - fixed, axis=2).mean(axis=1)
    errors = np.linalg.norm(VERTEX @ rotations.swapaxes(1, 2) + translations - VERTEX, axis=1)
    assert abs(np.corrcoef(residuals, errors)[0, 1]) < 0.06


def test_invalid_arguments_of_a_prediction_are_refused() -> None:
    with pytest.raises(GeometryError, match="targets"):
        predict_tre(HEAD, (1.0, 2.0), 0.001)
    for noise in (0.0, -0.001, np.nan):
        with pytest.raises(GeometryError, match="give a positive length"):
            predict_tre(HEAD, VERTEX, noise)
    with pytest.raises(GeometryError, match="positive definite"):
        predict_tre(HEAD, VERTEX, np.zeros((6, 3, 3)))
    with pytest.raises(GeometryError, match="weights"):
        predict_tre(HEAD, VERTEX, 0.001, weights=[1.0])
    with pytest.raises(DegeneratePointsError):
        predict_tre(HEAD[:2], VERTEX, 0.001)
