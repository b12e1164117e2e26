"""Least squares of landmarks and points of a surface, linearized about one registration.

The unknowns are a small motion of the registration and the offsets of the touched points from the surface. A point
``p_k`` in body_ref with the nearest point ``c_k`` and the outward unit normal ``n_k`` there has the residual

    r_k = n_k . (p_k - c_k) - sum_g m_kg o_g,

where ``o_g`` is the offset of region g along the normal (hair, a tip that does not reach the skin, or skin that gives
way), and ``m_kg`` is 1 if the point belongs to the region, otherwise 0. A motion ``x = (rotation vector, translation)``
moves ``c_k`` by ``J_k x``, so that ``(n_k^T J_k, m_k)`` is the row of the Jacobian. The offsets have normal priors: one
more row of the least squares for each of them (A. Gelman et al., Bayesian Data Analysis, 3rd ed. 2013, 14.8). The
inverse of the whole information is the covariance of motion and offsets together. Its block of the motion therefore
includes the uncertainty of the offsets.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Literal

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError
from pcmrs.registration._points import checked_point, register_points
from pcmrs.registration.rigid import motion_jacobians
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Floats, Transform

Mask = npt.NDArray[np.bool_]
OffsetRegion = Literal["everywhere", "hair", "face"]
"""Region of points that have one offset."""
MOTION = 6
"""Number of unknowns of the motion, which come before the offsets."""


@dataclass(frozen=True)
class OffsetPrior:
    """Expected offset along the outward normal between the touched points of a region and the surface.

    Attributes:
        region: Region of the points: ``hair`` and ``face`` as `hair_side` separates them, or ``everywhere``.
        mean: Expected offset, outwards, m.
        sigma: Standard deviation of this expectation, m.
        limit: Largest plausible offset in either direction, m.
    """

    region: OffsetRegion
    mean: float
    sigma: float
    limit: float


@dataclass(frozen=True, eq=False)
class SurfaceProblem:
    """Checked landmarks, surface and touched points.

    Attributes:
        landmarks_image: Landmarks as planned, in the image, m, (N, 3).
        landmarks_body_ref: Landmarks as digitized, in body_ref, m, (N, 3).
        sigma: Standard deviation of a digitized landmark per axis, m.
        surface: Surface in the image.
        middle: Middle of the widest place of the surface, in the image, m, (3,).
        points_body_ref: Points touched on the surface, in body_ref, m, (K, 3).
        sigma_surface: Standard deviation of a touched point along the normal, m.
        trim: Share of the points that is used.
        target: Point in the image at which the error is predicted, m, (3,).
        priors: Priors of the G offsets.
        members: Points of each prior's region, (K, G).
    """

    landmarks_image: Floats
    landmarks_body_ref: Floats
    sigma: float
    surface: TriangleSurface
    middle: Floats
    points_body_ref: Floats
    sigma_surface: float
    trim: float
    target: Floats
    priors: tuple[OffsetPrior, ...]
    members: Mask

    @property
    def expected_offsets(self) -> Floats:
        """Means of the priors, m, (G,)."""
        return np.array([prior.mean for prior in self.priors], dtype=float)

    @property
    def inlier_count(self) -> int:
        """Number of points that remain after trimming."""
        return math.ceil(self.trim * len(self.points_body_ref))

    def landmark_information(self, registration: Transform) -> Floats:
        """Return the information of the landmarks about the motion, (6, 6)."""
        jacobians = motion_jacobians(registration @ self.landmarks_image)
        information: Floats = np.einsum("nij,nik->jk", jacobians, jacobians) / self.sigma**2
        return information

    def fixed_information(self, registration: Transform) -> Floats:
        """Return the information of landmarks and priors about motion and offsets, (6 + G, 6 + G)."""
        information = np.diag([0.0] * MOTION + [prior.sigma**-2 for prior in self.priors])
        information[:MOTION, :MOTION] = self.landmark_information(registration)
        return information

    def surface_rows(self, registration: Transform, at_image: Floats, normals_image: Floats, members: Mask) -> Floats:
        """Return the rows of the Jacobian of points of the surface, (I, 6 + G).

        Args:
            registration: ``body_ref_from_image``.
            at_image: Points of the surface in the image, m, (I, 3).
            normals_image: Outward unit normals there, (I, 3).
            members: Regions of the points, (I, G).
        """
        normals = normals_image @ registration.rotation.T
        motion = np.einsum("ki,kij->kj", normals, motion_jacobians(registration @ at_image))
        return np.hstack((motion, members.astype(float)))

    def tre(self, registration: Transform, covariance: Floats) -> float:
        """Return the rms error at the target of a registration with this covariance, m.

        Args:
            registration: ``body_ref_from_image``.
            covariance: Covariance whose first six rows are those of the motion, (6 + G, 6 + G) or (6, 6).
        """
        (jacobian,) = motion_jacobians((registration @ self.target)[None])
        return float(np.sqrt(np.trace(jacobian @ covariance[:MOTION, :MOTION] @ jacobian.T)))


@dataclass(frozen=True, eq=False)
class Linearized:
    """Least-squares problem linearized about one registration and its offsets.

    Attributes:
        fixed_information: Information of landmarks and priors, (6 + G, 6 + G).
        surface_information: Information of the inliers without a correction for their selection, (6 + G, 6 + G).
        gradient: Gradient of half the sum of squares, negative, (6 + G,).
        normals: Unit normals at the inliers, in body_ref, (I, 3).
        inliers: Mask of the inliers, (K,).
        rms: Root mean square residual of the inliers, m.
    """

    fixed_information: Floats
    surface_information: Floats
    gradient: Floats
    normals: Floats
    inliers: Mask
    rms: float


def checked_problem(
    registration: Transform,
    landmarks_image: npt.ArrayLike,
    landmarks_body_ref: npt.ArrayLike,
    sigma: float,
    vertices: npt.ArrayLike,
    faces: npt.ArrayLike,
    points_body_ref: npt.ArrayLike,
    sigma_surface: float,
    target: npt.ArrayLike,
    trim: float,
    offsets: Sequence[OffsetPrior],
) -> SurfaceProblem:
    """Return the problem of `refine_with_surface` and `surface_coverage`, whose arguments these are.

    Raises:
        GeometryError: Shapes are wrong, numbers are not finite, or a standard deviation, `trim` or a prior is out of
            range.
        DegeneratePointsError: The landmarks do not determine a rotation.
        MirroredPointsError: A mirror image fits the landmarks far better than any rotation.
    """
    register_points(landmarks_body_ref, landmarks_image)  # raises if no registration could use these landmarks
    surface = TriangleSurface(vertices, faces)
    middle = widest_middle(np.asarray(vertices, dtype=float))
    points = _surface_points(points_body_ref)
    priors = _priors(offsets)
    return SurfaceProblem(
        np.asarray(landmarks_image, dtype=float),
        np.asarray(landmarks_body_ref, dtype=float),
        _positive(sigma, "sigma"),
        surface,
        middle,
        points,
        _positive(sigma_surface, "sigma_surface"),
        _fraction(trim),
        checked_point(target, "target"),
        priors,
        # At the start only: members that changed with each step would let the iteration jump between two solutions.
        members_of(priors, registration.inverse() @ points, middle),
    )


def linearize(problem: SurfaceProblem, registration: Transform, offsets: Floats) -> Linearized:
    """Return the least-squares problem about a registration and offsets (G,), m, with nearest points and inliers."""
    points = problem.points_body_ref
    closest_image, normals_image = problem.surface.closest(registration.inverse() @ points)
    closest, normals = registration @ closest_image, normals_image @ registration.rotation.T
    apart = points - closest - (problem.members @ offsets)[:, None] * normals
    distances = np.linalg.norm(apart, axis=1)
    inliers = np.zeros(len(points), dtype=bool)
    inliers[np.argsort(distances, kind="stable")[: problem.inlier_count]] = True
    residuals = np.sum(apart[inliers] * normals[inliers], axis=1)
    rows = problem.surface_rows(registration, closest_image[inliers], normals_image[inliers], problem.members[inliers])
    mapped = registration @ problem.landmarks_image
    gradient = residuals @ rows / problem.sigma_surface**2
    pull = np.einsum("nij,ni->j", motion_jacobians(mapped), problem.landmarks_body_ref - mapped)
    gradient[:MOTION] += pull / problem.sigma**2
    gradient[MOTION:] += [
        (prior.mean - offset) / prior.sigma**2 for prior, offset in zip(problem.priors, offsets, strict=True)
    ]
    return Linearized(
        fixed_information=problem.fixed_information(registration),
        surface_information=rows.T @ rows / problem.sigma_surface**2,
        gradient=gradient,
        normals=normals[inliers],
        inliers=inliers,
        rms=float(np.sqrt(np.mean(residuals**2))),
    )


def inverse(information: Floats) -> Floats:
    """Return the covariance that belongs to an information matrix."""
    return np.asarray(np.linalg.inv(information), dtype=float)


def trimming_efficiency(trim: float) -> float:
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


def members_of(priors: Sequence[OffsetPrior], points_image: Floats, middle: Floats) -> Mask:
    """Return which points (K, 3) in the image belong to the region of each prior, (K, G).

    Args:
        priors: Priors of the offsets.
        points_image: Points in the image, m, (K, 3).
        middle: Middle of the widest place of the surface, in the image, m, (3,).
    """
    hair = hair_side(points_image, middle)
    masks = {"everywhere": np.ones(len(hair), dtype=bool), "hair": hair, "face": ~hair}
    return np.array([masks[prior.region] for prior in priors], dtype=bool).reshape(len(priors), len(hair)).T


def hair_side(points_image: Floats, middle: Floats) -> Mask:
    """Return which points (K, 3) of a head, in an image whose axes are right, anterior and superior, may have hair.

    They are above the plane through the ears that rises to the front by 45°, as for `grow_hair` of MNE-Python (A.
    Gramfort et al., MEG and EEG data analysis with MNE-Python, Frontiers in Neuroscience 7 (2013) 267).
    """
    right_anterior_superior = points_image - middle
    above: Mask = right_anterior_superior[:, 2] > right_anterior_superior[:, 1]
    return above


def widest_middle(vertices: Floats) -> Floats:
    """Return the middle between the leftmost and the rightmost of the vertices (V, 3), on a head between the ears."""
    middle: Floats = (vertices[vertices[:, 0].argmin()] + vertices[vertices[:, 0].argmax()]) / 2.0
    return middle


def _priors(offsets: Sequence[OffsetPrior]) -> tuple[OffsetPrior, ...]:
    for prior in offsets:
        _positive(prior.sigma, "sigma of the offset")
        _positive(prior.limit, "limit of the offset")
        if not abs(prior.mean) <= prior.limit:
            text = f"The expected offset is {prior.mean:g} m, beyond its limit of {prior.limit:g} m."
            raise GeometryError(text, mean=prior.mean, limit=prior.limit)
    regions = [prior.region for prior in offsets]
    if len(set(regions)) < len(regions) or ("everywhere" in regions and len(regions) > 1):
        raise GeometryError(f"The offsets {', '.join(regions)} overlap; give one for each point.", regions=regions)
    return tuple(offsets)


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
