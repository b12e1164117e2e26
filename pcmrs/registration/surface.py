"""Refines a registration by points of the surface: trimmed point-to-plane ICP, anchored by the landmarks.

Point-to-plane after Y. Chen, G. Medioni, Object Modelling by Registration of Multiple Range Images, Image and Vision
Computing 10 (1992); trimming after D. Chetverikov, D. Stepanov, P. Krsek, Robust Euclidean Alignment of 3D Point Sets:
the Trimmed Iterative Closest Point Algorithm, Image and Vision Computing 23 (2005). The landmarks stay in the least
squares with their own deviation: where a surface slides on itself, as a skull cap does, they hold it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError, RefusalError
from pcmrs.registration import surface_checks as checks
from pcmrs.registration.points import checked_point, register_points
from pcmrs.registration.rigid import motion_jacobians
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Floats, Transform

MAX_ITERATIONS = 100
CONVERGED = 1e-6
"""The largest motion of a landmark in the last iteration, m: far below what any tracker measures."""


@dataclass(frozen=True, eq=False)
class SurfaceRefinement:
    """A registration to which a surface contributed.

    Attributes:
        body_ref_from_image: The refined registration.
        iterations: Until it stood still.
        inliers: Which points were used at the end, (K,) of bool.
        rms: Of the distances of these from the planes of their triangles, m.
        tre_before: Predicted TRE at the target by the landmarks alone, rms, m.
        tre_after: The same by landmarks and surface.
        covariance: Of the small motion ``(rotation vector, translation)`` in body_ref that is between the refined
            registration and the true one, rad and m, (6, 6).
    """

    body_ref_from_image: Transform
    iterations: int
    inliers: npt.NDArray[np.bool_]
    rms: float
    tre_before: float
    tre_after: float
    covariance: Floats


@dataclass(frozen=True, eq=False)
class _Problem:
    """What is known: see `refine_with_surface`."""

    landmarks_image: Floats
    landmarks_body_ref: Floats
    sigma: float
    surface: TriangleSurface
    points_body_ref: Floats
    sigma_surface: float
    trim: float


@dataclass(frozen=True, eq=False)
class _Linearized:
    """The least squares about one registration."""

    landmark_information: Floats  # (6, 6)
    surface_information: Floats  # (6, 6), as if inliers had not been selected
    gradient: Floats  # (6,)
    normals: Floats  # of the inliers, in body_ref, (I, 3)
    inliers: npt.NDArray[np.bool_]  # (K,)
    rms: float


def refine_with_surface(
    registration: Transform,
    landmarks_image: npt.ArrayLike,
    landmarks_body_ref: npt.ArrayLike,
    sigma: float,
    vertices: npt.ArrayLike,
    faces: npt.ArrayLike,
    points_body_ref: npt.ArrayLike,
    sigma_surface: float,
    target: npt.ArrayLike,
    trim: float = 0.9,
) -> SurfaceRefinement:
    """Moves a registration to where landmarks and surface together fit best.

    Args:
        registration: ``body_ref_from_image`` by the landmarks.
        landmarks_image: As planned, m, (N, 3).
        landmarks_body_ref: As digitized, in the same order, m, (N, 3).
        sigma: Deviation of a digitized landmark per axis, m.
        vertices: Of the surface in the image, m, (V, 3).
        faces: Its triangles, counter-clockwise seen from outside, (F, 3).
        points_body_ref: Points touched on the surface, m, (K, 3).
        sigma_surface: Deviation of such a point along the normal, m.
        target: Where the error matters, in the image, m, (3,).
        trim: Part of the points that is believed, the nearest ones; the rest may be anything.

    Raises:
        GeometryError: Shapes are wrong, numbers not finite, or a deviation or `trim` is out of range.
        DegeneratePointsError: The landmarks fix no rotation.
        MirroredPointsError: A mirror image fits the landmarks far better than any rotation.
        RefusalError: ``too_few_surface_points``, ``surface_far``, ``surface_flat``, ``surface_diverged``,
            ``surface_step_too_large``, ``surface_misfit`` or ``tre_not_lowered``: keep the landmarks' registration.
    """
    register_points(landmarks_body_ref, landmarks_image)  # refuses what no registration could use
    problem = _Problem(
        np.asarray(landmarks_image, dtype=float),
        np.asarray(landmarks_body_ref, dtype=float),
        _positive(sigma, "sigma"),
        TriangleSurface(vertices, faces),
        _surface_points(points_body_ref),
        _positive(sigma_surface, "sigma_surface"),
        _fraction(trim),
    )
    target_image = checked_point(target, "target")
    checks.check_count(len(problem.points_body_ref), _believed(problem))
    before = _covariance(_landmark_information(problem, registration))
    _check_near(problem, registration, before)
    refined, iterations = _iterate(problem, registration)
    at_end = _linearize(problem, refined)
    checks.check_step(refined @ registration.inverse(), before)
    kept = _kept_information(problem.trim)
    checks.check_fit(at_end.rms, problem.sigma_surface * math.sqrt(kept))
    covariance = _covariance(at_end.landmark_information + kept * at_end.surface_information)
    tre_before, tre_after = _tre(registration @ target_image, before), _tre(refined @ target_image, covariance)
    checks.check_gain(tre_before, tre_after)
    return SurfaceRefinement(refined, iterations, at_end.inliers, at_end.rms, tre_before, tre_after, covariance)


def _check_near(problem: _Problem, registration: Transform, covariance: Floats) -> None:
    points = problem.points_body_ref
    jacobians = motion_jacobians(points)
    variances = np.einsum("kij,jl,kil->k", jacobians, covariance, jacobians) / 3.0 + problem.sigma_surface**2
    checks.check_near(problem.surface.reach(registration.inverse() @ points), np.sqrt(variances))


def _iterate(problem: _Problem, registration: Transform) -> tuple[Transform, int]:
    """Gauss-Newton with new nearest points and new inliers each time."""
    refined = registration
    for iteration in range(1, MAX_ITERATIONS + 1):
        here = _linearize(problem, refined)
        checks.check_curvature(here.normals)
        step = np.linalg.solve(here.landmark_information + here.surface_information, here.gradient)
        moved = Transform.from_rotvec(step[3:], step[:3]) @ refined
        motion = np.abs((moved @ problem.landmarks_image) - (refined @ problem.landmarks_image)).max()
        refined = moved
        if motion < CONVERGED:
            return refined, iteration
    text = f"The refinement still moves {motion * 1000:.3g} mm after {MAX_ITERATIONS} iterations; touch more points."
    raise RefusalError("surface_diverged", text, motion=float(motion), iterations=MAX_ITERATIONS)


def _linearize(problem: _Problem, registration: Transform) -> _Linearized:
    points = problem.points_body_ref
    closest_image, normals_image = problem.surface.closest(registration.inverse() @ points)
    closest = registration @ closest_image
    distances = np.linalg.norm(points - closest, axis=1)
    inliers = np.zeros(len(points), dtype=bool)
    inliers[np.argsort(distances, kind="stable")[: _believed(problem)]] = True
    normals = normals_image[inliers] @ registration.rotation.T
    off_plane = np.sum((points - closest)[inliers] * normals, axis=1)
    rows = np.einsum("ki,kij->kj", normals, motion_jacobians(closest[inliers]))
    mapped = registration @ problem.landmarks_image
    pull = np.einsum("nij,ni->j", motion_jacobians(mapped), problem.landmarks_body_ref - mapped)
    return _Linearized(
        landmark_information=_landmark_information(problem, registration),
        surface_information=rows.T @ rows / problem.sigma_surface**2,
        gradient=pull / problem.sigma**2 + off_plane @ rows / problem.sigma_surface**2,
        normals=normals,
        inliers=inliers,
        rms=float(np.sqrt(np.mean(off_plane**2))),
    )


def _landmark_information(problem: _Problem, registration: Transform) -> Floats:
    jacobians = motion_jacobians(registration @ problem.landmarks_image)
    information: Floats = np.einsum("nij,nik->jk", jacobians, jacobians) / problem.sigma**2
    return information


def _covariance(information: Floats) -> Floats:
    return np.asarray(np.linalg.inv(information), dtype=float)


def _believed(problem: _Problem) -> int:
    return math.ceil(problem.trim * len(problem.points_body_ref))


def _kept_information(trim: float) -> float:
    """What an inlier tells, as a part of what a point tells that was not selected for being near.

    The variance of a normal distribution cut at the quantile q of `trim`, (2 Φ(q) − 1 − 2 q φ(q)) / trim: the
    asymptotic efficiency of least trimmed squares (P. J. Rousseeuw, A. M. Leroy, Robust Regression, 1987, 4.2). Where
    the trimmed points were outliers, it errs to the safe side.
    """
    if trim == 1.0:
        return 1.0
    normal = NormalDist()
    quantile = normal.inv_cdf((1.0 + trim) / 2.0)
    return (trim - 2.0 * quantile * normal.pdf(quantile)) / trim


def _tre(target: Floats, covariance: Floats) -> float:
    """Rms of the error at a target (3,) in body_ref whose registration has this covariance, m."""
    (jacobian,) = motion_jacobians(target[None])
    return float(np.sqrt(np.trace(jacobian @ covariance @ jacobian.T)))


def _surface_points(values: npt.ArrayLike) -> Floats:
    points = np.asarray(values, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
        text = f"The surface points have shape {points.shape}; give finite points (K, 3), in m."
        raise GeometryError(text, shape=points.shape)
    return points


def _positive(value: float, name: str) -> float:
    if not 0.0 < value < math.inf:
        raise GeometryError(f"{name} is {value:g} m; give a positive length.", name=name, value=value)
    return value


def _fraction(trim: float) -> float:
    if not 0.5 <= trim <= 1.0:
        raise GeometryError(f"trim is {trim:g}, must be from 0.5 to 1.", name="trim", value=trim)
    return trim
