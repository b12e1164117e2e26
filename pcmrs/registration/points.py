"""Point-based rigid registration in closed form.

K. S. Arun, T. S. Huang, S. D. Blostein, Least-Squares Fitting of Two 3-D Point Sets, IEEE PAMI 9 (1987); the
reflection is handled after S. Umeyama, Least-Squares Estimation of Transformation Parameters Between Two Point
Patterns, IEEE PAMI 13 (1991).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcmrs.errors import DegeneratePointsError, GeometryError
from pcmrs.spatial import Floats, Transform

MIN_POINTS = 3
MIN_SPREAD = 1e-3  # m: largest singular value over sqrt(N) of points that do not coincide
MIN_SHAPE = 0.02  # second over first singular value: below it, points lie on a line for all practical purposes


@dataclass(frozen=True, eq=False)
class PointRegistration:
    """A rigid transform fitted to pairs of points.

    Attributes:
        fixed_from_moving: Maps the moving points onto the fixed ones.
        residual: Mean distance between the pairs after mapping, m.
        rms: Root mean square of these distances (the fiducial registration error, FRE), m.
        distances: Of each pair, m, (N,).
        singular_values: Of the moving points about their centroid, descending, m, (3,).
    """

    fixed_from_moving: Transform
    residual: float
    rms: float
    distances: Floats
    singular_values: Floats


def register_points(fixed: npt.ArrayLike, moving: npt.ArrayLike) -> PointRegistration:
    """The rigid transform that maps `moving` onto `fixed` with the least sum of squared distances.

    Args:
        fixed: Points in the fixed frame, m, (N, 3).
        moving: The same points in the moving frame, in the same order, m, (N, 3).

    Raises:
        GeometryError: Shapes differ or are not (N, 3), or a number is not finite.
        DegeneratePointsError: Fewer than three points, or one of the sets is coincident or on a line.
    """
    fixed, moving = _points(fixed, "fixed"), _points(moving, "moving")
    if fixed.shape != moving.shape:
        raise GeometryError(
            f"There are {len(fixed)} fixed points but {len(moving)} moving points; give them in pairs.",
            fixed=len(fixed),
            moving=len(moving),
        )
    _check_spread(fixed, "fixed")
    singular_values = _check_spread(moving, "moving")
    fixed_from_moving = _fit(fixed, moving)
    distances = np.linalg.norm(fixed_from_moving @ moving - fixed, axis=1)
    return PointRegistration(
        fixed_from_moving=fixed_from_moving,
        residual=float(distances.mean()),
        rms=float(np.sqrt(np.mean(distances**2))),
        distances=distances,
        singular_values=singular_values,
    )


def _fit(fixed: Floats, moving: Floats) -> Transform:
    fixed_centroid, moving_centroid = fixed.mean(axis=0), moving.mean(axis=0)
    covariance = (fixed - fixed_centroid).T @ (moving - moving_centroid)
    u, _, vt = np.linalg.svd(covariance)
    # The sign goes to the smallest singular value: there a flip costs least, and nothing when points are coplanar.
    handedness = np.sign(np.linalg.det(u) * np.linalg.det(vt))
    rotation = u @ np.diag((1.0, 1.0, handedness)) @ vt
    return Transform(rotation, fixed_centroid - rotation @ moving_centroid)


def _points(values: npt.ArrayLike, which: str) -> Floats:
    points = np.asarray(values, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise GeometryError(f"The {which} points have shape {points.shape}, must be (N, 3).", shape=points.shape)
    if not np.isfinite(points).all():
        rows = np.flatnonzero(~np.isfinite(points).all(axis=1)).tolist()
        raise GeometryError(f"The {which} points {rows} hold a number that is not finite; measure again.", rows=rows)
    return points


def _check_spread(points: Floats, which: str) -> Floats:
    """The singular values of the points about their centroid, m, (3,).

    Raises:
        DegeneratePointsError: The points do not fix a rotation.
    """
    count = len(points)
    values: Floats = np.zeros(3)
    if count:
        found = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        values[: len(found)] = found
    if count < MIN_POINTS:
        problem = f"are {count}, at least {MIN_POINTS} are needed"
    elif values[0] < MIN_SPREAD * np.sqrt(count):
        problem = f"coincide within {values[0] / np.sqrt(count) * 1e3:.3g} mm, limit {MIN_SPREAD * 1e3:g} mm"
    elif values[1] < MIN_SHAPE * values[0]:
        problem = f"lie on a line (ratio of singular values {values[1] / values[0]:.3g}, limit {MIN_SHAPE:g})"
    else:
        return values
    raise DegeneratePointsError(
        f"The {which} points {problem}; choose points that span a triangle.",
        points=which,
        count=count,
        singular_values=values.tolist(),
    )
