"""Surface refinement against simulated truth: a superellipsoid head, a sphere cap, and what must be refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from scipy.spatial import ConvexHull

from pcmrs.errors import DegeneratePointsError, GeometryError, RefusalError
from pcmrs.registration import predict_tre, register_points
from pcmrs.registration.surface import SurfaceRefinement, refine_with_surface
from pcmrs.spatial import Floats, Transform, rotation_angle
from tests.support.trials import run_counts

SIGMA, SIGMA_SURFACE = 1.86e-3, 0.5e-3
TARGET = np.array([0.03, 0.0, 0.10])
SEMI_AXES = np.array([0.078, 0.098, 0.108])
TRUTH = Transform.from_rotvec((0.1, -0.2, 0.05), (0.3, 2.0, -0.7))
LANDMARKS = np.array(
    [(0, 98, 5), (0, 110, -45), (-50, 82, 0), (50, 82, 0), (-82, 4, -16), (82, 4, -16)], dtype=float
) / np.array(1000.0)


def on_head(directions: Floats) -> Floats:
    """A superellipsoid of exponent 2.3 (Barr 1981), met by rays from its centre."""
    powers = np.sum(np.abs(directions / SEMI_AXES) ** 2.3, axis=1, keepdims=True)
    points: Floats = directions * powers ** (-1 / 2.3)
    return points


def hull(points: Floats) -> tuple[Floats, npt.NDArray[np.int64]]:
    """Triangles about convex points, turned outwards."""
    faces = ConvexHull(points).simplices.astype(np.int64)
    a, b, c = np.moveaxis(points[faces], 1, 0)
    inwards = np.sum(np.cross(b - a, c - a) * (a - points.mean(axis=0)), axis=1) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    return points, faces


def evenly(count: int) -> Floats:
    """Directions spread over the sphere (Fibonacci lattice)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    around = np.sqrt(1.0 - z**2)
    return np.column_stack((around * np.cos(angle), around * np.sin(angle), z))


HEAD = hull(on_head(evenly(3000)))


def above(rng: np.random.Generator, count: int) -> Floats:
    directions = rng.normal(size=(count, 3))
    directions[:, 2] = np.abs(directions[:, 2])
    return directions


def refine(seed: int, **given: Any) -> tuple[Transform, SurfaceRefinement]:
    """The landmarks' registration and the refined one of a simulated session."""
    rng = np.random.default_rng(seed)
    digitized = TRUTH @ LANDMARKS + rng.normal(0.0, SIGMA, LANDMARKS.shape)
    count = given.pop("count", 100)
    touched = TRUTH @ on_head(above(rng, count)) + rng.normal(0.0, SIGMA_SURFACE, (count, 3))
    outliers = given.pop("outliers", 0)
    touched[:outliers] += rng.normal(0.0, 0.010, (outliers, 3))
    registration = register_points(digitized, LANDMARKS).fixed_from_moving
    arguments: dict[str, Any] = {
        "registration": registration,
        "landmarks_image": LANDMARKS,
        "landmarks_body_ref": digitized,
        "sigma": SIGMA,
        "vertices": HEAD[0],
        "faces": HEAD[1],
        "points_body_ref": touched,
        "sigma_surface": SIGMA_SURFACE,
        "target": TARGET,
    } | given
    return registration, refine_with_surface(**arguments)


def error(found: Transform) -> float:
    return float(np.linalg.norm(found @ TARGET - TRUTH @ TARGET))


def rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


@run_counts(20, nightly=60)
@pytest.mark.parametrize("given", [{}, {"trim": 1.0}, {"outliers": 8}, {"count": 40}])
def test_the_true_error_falls_and_is_what_was_predicted(given: dict[str, Any], runs: int) -> None:
    sessions = [refine(seed, **given) for seed in range(runs)]
    before = rms([error(registration) for registration, _ in sessions])
    after = rms([error(refined.body_ref_from_image) for _, refined in sessions])
    assert after < 0.5 * before
    assert rms([refined.tre_before for _, refined in sessions]) == pytest.approx(before, rel=0.25)
    assert rms([refined.tre_after for _, refined in sessions]) == pytest.approx(after, rel=0.25)


def test_the_prediction_before_is_that_of_the_landmarks() -> None:
    registration, refined = refine(1)
    (expected,) = predict_tre(registration @ LANDMARKS, registration @ TARGET, SIGMA)
    assert refined.tre_before == pytest.approx(expected, rel=1e-9)


@run_counts(20, nightly=60)
def test_the_covariance_is_that_of_the_motion_left(runs: int) -> None:
    """Mahalanobis distances of the true errors: their mean is the number of freedoms.

    The mesh of 3,000 corners lies within the head that is touched by about a tenth of the probe's deviation, which adds
    to it: with 20,000 corners the mean is 6 within what 200 sessions can tell.
    """
    squares = []
    for seed in range(runs):
        _, refined = refine(seed, trim=1.0)
        left = TRUTH @ refined.body_ref_from_image.inverse()
        motion = np.concatenate((left.rotvec, left.translation))
        squares.append(motion @ np.linalg.solve(refined.covariance, motion))
    assert np.mean(squares) == pytest.approx(6.0, rel=0.25)


def test_without_noise_the_truth_is_found_from_a_shifted_start() -> None:
    start = Transform.from_rotvec((0.001, -0.001, 0.0005), (0.01, 0.0, -0.01)) @ TRUTH
    _, refined = refine(
        3,
        registration=start,
        landmarks_body_ref=TRUTH @ LANDMARKS,
        points_body_ref=TRUTH @ HEAD[0][:200],
    )
    assert error(refined.body_ref_from_image) < 1e-5
    assert rotation_angle(refined.body_ref_from_image, TRUTH) < 1e-4
    assert refined.inliers.sum() == 180


def test_outliers_are_trimmed() -> None:
    _, refined = refine(5, outliers=8)
    assert refined.inliers.sum() == 90
    assert refined.rms < 2 * SIGMA_SURFACE


@run_counts(15, nightly=40)
def test_a_sphere_slides_on_itself_and_landmarks_hold_it(runs: int) -> None:
    """Points of a sphere say nothing of rotations about its centre: there the landmarks' solution stays."""
    sphere = hull(0.09 * evenly(3000))
    turned, held = [], []
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        cap = above(rng, 100)
        cap *= 0.09 / np.linalg.norm(cap, axis=1, keepdims=True)
        registration, refined = refine(
            seed, vertices=sphere[0], faces=sphere[1], points_body_ref=TRUTH @ cap + rng.normal(0.0, 5e-4, cap.shape)
        )
        turned.append(rotation_angle(registration, TRUTH))
        held.append(rotation_angle(refined.body_ref_from_image, TRUTH))
        centre = refined.body_ref_from_image @ np.zeros(3) - TRUTH @ np.zeros(3)
        assert np.linalg.norm(centre) < 0.0015  # what the sphere does know
        assert refined.tre_after < refined.tre_before
    assert rms(held) < 1.05 * rms(turned)


def patch(angle: float, count: int = 60) -> Floats:
    """Points of the head within an angle (rad) of superior."""
    rng = np.random.default_rng(0)
    tilt, azimuth = angle * np.sqrt(rng.uniform(0, 1, count)), rng.uniform(0, 2 * np.pi, count)
    across = np.sin(tilt)
    return on_head(np.column_stack((across * np.cos(azimuth), across * np.sin(azimuth), np.cos(tilt))))


HALF = TRUTH @ on_head(above(np.random.default_rng(9), 60))


@pytest.mark.parametrize(
    ("given", "code"),
    [
        ({"points_body_ref": HALF[:22]}, None),
        ({"points_body_ref": HALF[:21]}, "too_few_surface_points"),
        ({"points_body_ref": np.empty((0, 3))}, "too_few_surface_points"),
        ({"points_body_ref": TRUTH @ patch(0.15)}, "surface_flat"),
        ({"points_body_ref": HALF + 0.05}, "surface_far"),
        ({"vertices": HEAD[0] * 1000.0}, "surface_far"),
        ({"vertices": HEAD[0] * (-1.0, -1.0, 1.0) + (0.02, 0.06, 0.0)}, "surface_far"),
        ({"points_body_ref": HALF + np.array((0.0, 0.0, 0.007))}, "surface_step_too_large"),
        ({"points_body_ref": HALF + np.random.default_rng(4).normal(0.0, 0.003, HALF.shape)}, "surface_misfit"),
        ({"sigma_surface": 0.05}, "tre_not_lowered"),
    ],
)
def test_refinement_that_would_not_help_is_refused(given: dict[str, Any], code: str | None) -> None:
    clean = {"landmarks_body_ref": TRUTH @ LANDMARKS, "registration": TRUTH}
    if code is None:
        refine(7, **clean, **given)
        return
    with pytest.raises(RefusalError) as caught:
        refine(7, **clean, **given)
    assert caught.value.refusal_code == code


@pytest.mark.parametrize(
    "given",
    [
        {"sigma": 0.0},
        {"sigma_surface": float("nan")},
        {"trim": 0.4},
        {"trim": 1.1},
        {"target": (0.0, 0.0)},
        {"target": np.zeros((2, 3))},
        {"points_body_ref": np.zeros(3)},
        {"points_body_ref": np.full((30, 3), np.nan)},
        {"landmarks_image": LANDMARKS[:5]},
        {"faces": np.array([(0, 1, 3000)])},
        {"faces": np.empty((0, 3), dtype=int)},
        {"vertices": np.zeros((3000, 3))},
        {"vertices": np.full((3000, 3), np.inf)},
    ],
)
def test_malformed_input_is_refused(given: dict[str, Any]) -> None:
    with pytest.raises(GeometryError):
        refine(7, **given)


@pytest.mark.parametrize("landmarks", [LANDMARKS[:2], np.outer(np.arange(6), (0.02, 0.01, 0.03))])
def test_landmarks_that_hold_nothing_are_refused(landmarks: Floats) -> None:
    with pytest.raises(DegeneratePointsError):
        refine(7, registration=TRUTH, landmarks_image=landmarks, landmarks_body_ref=TRUTH @ landmarks)
