"""Refinement of a registration by points of the surface: trimmed point-to-plane ICP, anchored by the landmarks.

Point-to-plane after Y. Chen, G. Medioni, Object Modelling by Registration of Multiple Range Images, Image and Vision
Computing 10 (1992); trimming after D. Chetverikov, D. Stepanov, P. Krsek, Robust Euclidean Alignment of 3D Point Sets:
the Trimmed Iterative Closest Point Algorithm, Image and Vision Computing 23 (2005). The landmarks stay in the least
squares with their own standard deviation. They hold the registration where the surface can slide on itself, as a skull
cap does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError, RefusalError
from pcmrs.registration import _surface_checks as checks
from pcmrs.registration._points import checked_point, register_points
from pcmrs.registration.rigid import motion_jacobians
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Floats, Transform

__all__ = ["SurfaceRefinement", "refine_with_surface"]

MAX_ITERATIONS = 100
CONVERGED = 1e-6
"""Largest motion of a landmark in the last iteration, m: far below the resolution of any tracker."""


@dataclass(frozen=True, eq=False)
class SurfaceRefinement:
    """Registration that was refined by a surface.

    Attributes:
        body_ref_from_image: Refined registration.
        iterations: Number of iterations until convergence.
        inliers: Mask of the points that were used at the end, (K,).
        rms: Root mean square distance of the inliers from the planes of their triangles, m.
        tre_before: Predicted rms TRE at the target with the landmarks alone, m.
        tre_after: Predicted rms TRE at the target with landmarks and surface, m.
        covariance: Covariance of the small motion ``(rotation vector, translation)`` in body_ref between the refined
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
    """Checked arguments of `refine_with_surface`."""

    landmarks_image: Floats
    landmarks_body_ref: Floats
    sigma: float
    surface: TriangleSurface
    points_body_ref: Floats
    sigma_surface: float
    trim: float


@dataclass(frozen=True, eq=False)
class _Linearized:
    """Least-squares problem linearized about one registration."""

    landmark_information: Floats  # (6, 6)
    surface_information: Floats  # (6, 6), without a correction for the selection of inliers
    gradient: Floats  # (6,)
    normals: Floats  # unit normals at the inliers, in body_ref, (I, 3)
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
    """Move a registration to where landmarks and surface together fit best.

    Args:
        registration: ``body_ref_from_image`` by the landmarks.
        landmarks_image: Landmarks as planned, in the image, m, (N, 3).
        landmarks_body_ref: Landmarks as digitized, in body_ref and in the same order, m, (N, 3).
        sigma: Standard deviation of a digitized landmark per axis, m.
        vertices: Vertices of the surface in the image, m, (V, 3).
        faces: Triangles of the surface, counter-clockwise seen from outside, (F, 3).
        points_body_ref: Points touched on the surface, in body_ref, m, (K, 3).
        sigma_surface: Standard deviation of a touched point along the normal, m.
        target: Point in the image at which the error is predicted, m, (3,).
        trim: Share of the points that is used, those nearest to the surface. The others may be outliers.

    Raises:
        GeometryError: Shapes are wrong, numbers are not finite, or a standard deviation or `trim` is out of range.
        DegeneratePointsError: The landmarks do not determine a rotation.
        MirroredPointsError: A mirror image fits the landmarks far better than any rotation.
        RefusalError: ``too_few_surface_points``, ``surface_far``, ``surface_flat``, ``surface_diverged``,
            ``surface_step_too_large``, ``surface_misfit`` or ``tre_not_lowered``: keep the landmarks' registration.
    """
    register_points(landmarks_body_ref, landmarks_image)  # raises if no registration could use these landmarks
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
    checks.check_count(len(problem.points_body_ref), _inlier_count(problem))
    before = _covariance(_landmark_information(problem, registration))
    _check_near(problem, registration, before)
    refined, iterations = _iterate(problem, registration)
    final = _linearize(problem, refined)
    checks.check_step(refined @ registration.inverse(), before)
    efficiency = _trimming_efficiency(problem.trim)
    checks.check_fit(final.rms, problem.sigma_surface * math.sqrt(efficiency))
    covariance = _covariance(final.landmark_information + efficiency * final.surface_information)
    tre_before, tre_after = _tre(registration @ target_image, before), _tre(refined @ target_image, covariance)
    checks.check_gain(tre_before, tre_after)
    return SurfaceRefinement(refined, iterations, final.inliers, final.rms, tre_before, tre_after, covariance)


def _check_near(problem: _Problem, registration: Transform, covariance: Floats) -> None:
    points = problem.points_body_ref
    jacobians = motion_jacobians(points)
    # A third of the trace is the mean variance along one direction, such as the normal.
    variances = np.einsum("kij,jl,kil->k", jacobians, covariance, jacobians) / 3.0 + problem.sigma_surface**2
    checks.check_near(problem.surface.distance_bounds(registration.inverse() @ points), np.sqrt(variances))


def _iterate(problem: _Problem, registration: Transform) -> tuple[Transform, int]:
    """Iterate Gauss-Newton steps, with new nearest points and new inliers in each step."""
    refined = registration
    for iteration in range(1, MAX_ITERATIONS + 1):
        linearized = _linearize(problem, refined)
        # In every iteration, because the inliers change.
        checks.check_curvature(linearized.normals)
        step = np.linalg.solve(linearized.landmark_information + linearized.surface_information, linearized.gradient)
        moved = Transform.from_rotvec(step[3:], step[:3]) @ refined
        motion = np.abs((moved @ problem.landmarks_image) - (refined @ problem.landmarks_image)).max()
        refined = moved
        if motion < CONVERGED:
            return refined, iteration
    text = f"The refinement still moves {motion * 1000:.3g} mm after {MAX_ITERATIONS} iterations; touch more points."
    raise RefusalError("surface_diverged", text, motion=float(motion), iterations=MAX_ITERATIONS)


def _linearize(problem: _Problem, registration: Transform) -> _Linearized:
    """Return the least-squares problem about a registration, with its nearest points and inliers."""
    points = problem.points_body_ref
    closest_image, normals_image = problem.surface.closest(registration.inverse() @ points)
    closest = registration @ closest_image
    distances = np.linalg.norm(points - closest, axis=1)
    inliers = np.zeros(len(points), dtype=bool)
    inliers[np.argsort(distances, kind="stable")[: _inlier_count(problem)]] = True
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


def _inlier_count(problem: _Problem) -> int:
    return math.ceil(problem.trim * len(problem.points_body_ref))


def _trimming_efficiency(trim: float) -> float:
    """Return the information of an inlier relative to that of a point that was not selected for being near.

    It is the variance of a normal distribution cut at the quantile q of `trim`, (2 Φ(q) − 1 − 2 q φ(q)) / trim: the
    asymptotic efficiency of least trimmed squares (P. J. Rousseeuw, A. M. Leroy, Robust Regression, 1987, 4.2). If the
    trimmed points were outliers, it errs on the safe side.
    """
    if trim == 1.0:
        return 1.0
    normal = NormalDist()
    quantile = normal.inv_cdf((1.0 + trim) / 2.0)
    return (trim - 2.0 * quantile * normal.pdf(quantile)) / trim


def _tre(target: Floats, covariance: Floats) -> float:
    """Return the rms error at a target (3,) in body_ref of a registration with this covariance, m."""
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
