"""Refinement of a registration by points of the surface: trimmed point-to-plane ICP, anchored by the landmarks.

Point-to-plane after Y. Chen, G. Medioni, Object Modelling by Registration of Multiple Range Images, Image and Vision
Computing 10 (1992); trimming after D. Chetverikov, D. Stepanov, P. Krsek, Robust Euclidean Alignment of 3D Point Sets:
the Trimmed Iterative Closest Point Algorithm, Image and Vision Computing 23 (2005). The landmarks stay in the least
squares with their own standard deviation. They hold the registration where the surface can slide on itself, as a skull
cap does. A common distance of the points from the surface, such as hair, is estimated as well: `_surface_fit` has the
formulas.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcmrs.errors import RefusalError
from pcmrs.registration import _surface_checks as checks
from pcmrs.registration._surface_fit import (
    MOTION,
    OffsetPrior,
    OffsetRegion,
    SurfaceProblem,
    checked_problem,
    inverse,
    linearize,
    trimming_efficiency,
)
from pcmrs.registration.rigid import motion_jacobians
from pcmrs.spatial import Floats, Transform

__all__ = ["OffsetPrior", "SurfaceOffset", "SurfaceRefinement", "refine_with_surface"]

MAX_ITERATIONS = 100
CONVERGED = 1e-6
"""Largest motion of a landmark, and change of an offset, in the last iteration, m: far below the resolution of any
tracker."""


@dataclass(frozen=True)
class SurfaceOffset:
    """Estimated common offset of the touched points of a region.

    Attributes:
        region: Region of the points, see `OffsetPrior`.
        value: Distance of the points from the surface, outwards, m.
        deviation: Standard deviation of `value`, m.
        points: Number of points in the region that were used at the end. Without any, the value is that of the prior.
    """

    region: OffsetRegion
    value: float
    deviation: float
    points: int


@dataclass(frozen=True, eq=False)
class SurfaceRefinement:
    """Registration that was refined by a surface.

    Attributes:
        body_ref_from_image: Refined registration.
        iterations: Number of iterations until convergence.
        inliers: Mask of the points that were used at the end, (K,).
        rms: Root mean square distance of the inliers from the planes of their triangles, beyond their offset, m.
        tre_before: Predicted rms TRE at the target with the landmarks alone, m.
        tre_after: Predicted rms TRE at the target with landmarks and surface, m.
        covariance: Covariance of the small motion ``(rotation vector, translation)`` in body_ref between the refined
            registration and the true one, rad and m, (6, 6).
        offsets: Estimated offsets, in the order of their priors.
    """

    body_ref_from_image: Transform
    iterations: int
    inliers: npt.NDArray[np.bool_]
    rms: float
    tre_before: float
    tre_after: float
    covariance: Floats
    offsets: tuple[SurfaceOffset, ...]


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
    offsets: Sequence[OffsetPrior] = (),
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
        offsets: Priors of the common offsets to estimate: none, one for all points, or one for hair, face or each.

    Raises:
        GeometryError: Shapes are wrong, numbers are not finite, or a standard deviation, `trim` or a prior is out of
            range.
        DegeneratePointsError: The landmarks do not determine a rotation.
        MirroredPointsError: A mirror image fits the landmarks far better than any rotation.
        RefusalError: ``too_few_surface_points``, ``surface_far``, ``surface_flat``, ``surface_diverged``,
            ``surface_offset_too_large``, ``surface_step_too_large``, ``surface_misfit`` or ``tre_not_lowered``: keep
            the landmarks' registration.
    """
    problem = checked_problem(
        registration,
        landmarks_image,
        landmarks_body_ref,
        sigma,
        vertices,
        faces,
        points_body_ref,
        sigma_surface,
        target,
        trim,
        offsets,
    )
    checks.check_count(len(problem.points_body_ref), problem.inlier_count)
    before = inverse(problem.landmark_information(registration))
    _check_near(problem, registration, before)
    refined, values, iterations = _iterate(problem, registration)
    final = linearize(problem, refined, values)
    efficiency = trimming_efficiency(problem.trim)
    covariance = inverse(final.fixed_information + efficiency * final.surface_information)
    found = _offsets(problem, values, covariance, final.inliers)
    for prior, offset in zip(problem.priors, found, strict=True):
        checks.check_offset(offset.region, offset.value, offset.deviation, prior.limit)
    checks.check_step(refined @ registration.inverse(), before)
    checks.check_fit(final.rms, problem.sigma_surface * float(np.sqrt(efficiency)))
    tre_before, tre_after = problem.tre(registration, before), problem.tre(refined, covariance)
    checks.check_gain(tre_before, tre_after)
    motion = covariance[:MOTION, :MOTION]
    return SurfaceRefinement(refined, iterations, final.inliers, final.rms, tre_before, tre_after, motion, found)


def _check_near(problem: SurfaceProblem, registration: Transform, covariance: Floats) -> None:
    points = problem.points_body_ref
    jacobians = motion_jacobians(points)
    # A third of the trace is the mean variance along one direction, such as the normal.
    variances = np.einsum("kij,jl,kil->k", jacobians, covariance, jacobians) / 3.0 + problem.sigma_surface**2
    distances = problem.surface.distance_bounds(registration.inverse() @ points)
    # Which offset the points have is not known yet: their range is no distance from the surface.
    explained = problem.members @ np.array([prior.limit for prior in problem.priors], dtype=float)
    checks.check_near(np.maximum(distances - explained, 0.0), np.sqrt(variances))


def _iterate(problem: SurfaceProblem, registration: Transform) -> tuple[Transform, Floats, int]:
    """Iterate Gauss-Newton steps, with new nearest points and new inliers in each step."""
    refined, offsets = registration, problem.expected_offsets
    for iteration in range(1, MAX_ITERATIONS + 1):
        linearized = linearize(problem, refined, offsets)
        # In every iteration, because the inliers change.
        checks.check_curvature(linearized.normals)
        step = np.linalg.solve(linearized.fixed_information + linearized.surface_information, linearized.gradient)
        moved = Transform.from_rotvec(step[3:MOTION], step[:3]) @ refined
        motion = np.abs((moved @ problem.landmarks_image) - (refined @ problem.landmarks_image)).max()
        refined, offsets = moved, offsets + step[MOTION:]
        if np.max(np.abs(step[MOTION:]), initial=motion) < CONVERGED:
            return refined, offsets, iteration
    text = f"The refinement still moves {motion * 1000:.3g} mm after {MAX_ITERATIONS} iterations; touch more points."
    raise RefusalError("surface_diverged", text, motion=float(motion), iterations=MAX_ITERATIONS)


def _offsets(
    problem: SurfaceProblem, values: Floats, covariance: Floats, inliers: npt.NDArray[np.bool_]
) -> tuple[SurfaceOffset, ...]:
    deviations = np.sqrt(np.diagonal(covariance)[MOTION:])
    counts = problem.members[inliers].sum(axis=0)
    return tuple(
        SurfaceOffset(prior.region, float(value), float(deviation), int(count))
        for prior, value, deviation, count in zip(problem.priors, values, deviations, counts, strict=True)
    )
