"""Checked point-based rigid registration with weights, anisotropic noise and refusal of degenerate sets."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcmrs.errors import DegeneratePointsError, GeometryError, MirroredPointsError
from pcmrs.registration._anisotropic import fit_anisotropic
from pcmrs.registration.rigid import RigidFit, fit_rigid
from pcmrs.spatial import Floats, Transform, trusted_transform

MIN_POINTS = 3
MIN_SPREAD = 1e-3  # m: largest singular value over sqrt(N), below which points count as coincident
MIN_SHAPE = 0.02  # second over first singular value, below which points count as collinear
MIRROR_RATIO = 4.0
"""Greatest ratio of the rms residuals of the best rotation and the best reflection that noise explains. With four
points in the worst shape, noise exceeds it about once in a thousand sets; with a usual layout of landmarks practically
never."""
MIRROR_FLOOR = 0.25e-3  # m rms: if both residuals are smaller, their ratio has no meaning


@dataclass(frozen=True, eq=False, slots=True)
class PointRegistration:
    """A rigid transform fitted to pairs of points.

    Attributes:
        fixed_from_moving: Transform that maps the moving points onto the fixed ones.
        residual: Mean distance between the pairs after mapping, m. Points of weight zero do not count.
        rms: Root mean square of these distances (the fiducial registration error, FRE), m.
        mirror_ratio: Rms residual of the best rotation over that of the best reflection or `MIRROR_FLOOR`, whichever
            is larger; computed without covariances.
        distances: Distance of each pair after mapping, m, (N,).
        singular_values: Singular values of the moving points about their centroid, descending, m, (3,).
    """

    fixed_from_moving: Transform
    residual: float
    rms: float
    mirror_ratio: float
    distances: Floats
    singular_values: Floats


def register_points(
    fixed: npt.ArrayLike,
    moving: npt.ArrayLike,
    *,
    weights: npt.ArrayLike | None = None,
    covariances: npt.ArrayLike | None = None,
) -> PointRegistration:
    """Return the rigid transform that maps `moving` onto `fixed` with the least sum of squared distances.

    Args:
        fixed: Points in the fixed frame, m, (N, 3).
        moving: The same points in the moving frame, in the same order, m, (N, 3).
        weights: Weights of the squared distances, not negative, (N,). A point of weight zero does not count.
        covariances: Covariances of the fixed points' noise in the fixed frame, m^2, (N, 3, 3). With them, distances
            count by their likelihood (see `fit_anisotropic`). They cannot be combined with `weights`.

    Raises:
        GeometryError: Shapes differ or are wrong, a number is not finite, a weight is negative, or a covariance is not
            positive definite.
        DegeneratePointsError: There are fewer than three points, or one of the sets is coincident or collinear.
        MirroredPointsError: A mirror image fits far better than any rotation.
    """
    fixed, moving = checked_pairs(fixed, moving)
    counted = None if weights is None else _weights(weights, len(fixed))
    _check_count(moving, counted)
    fit = fit_rigid(fixed, moving, counted)
    _check_spread(fit.fixed, counted, "fixed")
    singular_values = _check_spread(fit.moving, counted, "moving")
    squares = fit.squares()
    mirror_ratio = _check_mirror(fit, squares, counted, singular_values)
    fixed_from_moving = trusted_transform(fit.rotation, fit.translation)
    if covariances is not None:
        fixed_from_moving = fit_anisotropic(fixed, moving, _covariances(covariances, weights, len(fixed)), fit)
        squares = np.sum((fixed_from_moving @ moving - fixed) ** 2, axis=1)
    distances = np.sqrt(squares)
    counting = distances if counted is None else distances[counted > 0.0]
    return PointRegistration(
        fixed_from_moving=fixed_from_moving,
        residual=float(np.add.reduce(counting)) / len(counting),
        rms=math.sqrt(float(counting @ counting) / len(counting)),
        mirror_ratio=mirror_ratio,
        distances=distances,
        singular_values=singular_values,
    )


def checked_pairs(fixed: npt.ArrayLike, moving: npt.ArrayLike) -> tuple[Floats, Floats]:
    """Return both sets as arrays (N, 3), m.

    Args:
        fixed: Points in the fixed frame, m, (N, 3).
        moving: The same points in the moving frame, in the same order, m, (N, 3).

    Raises:
        GeometryError: The sets are not pairs of finite points.
    """
    fixed, moving = _points(fixed, "fixed"), _points(moving, "moving")
    if fixed.shape != moving.shape:
        raise GeometryError(
            f"There are {len(fixed)} fixed points but {len(moving)} moving points; give them in pairs.",
            fixed=len(fixed),
            moving=len(moving),
        )
    return fixed, moving


def checked_point(values: npt.ArrayLike, which: str) -> Floats:
    """Return one point as an array (3,), m.

    Args:
        values: Coordinates, m, (3,).
        which: Name of the point in the error.

    Raises:
        GeometryError: The values are not a point, or not finite.
    """
    point = np.asarray(values, dtype=float)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise GeometryError(f"The {which} is {point.tolist()}; give three finite numbers, in m.", which=which)
    return point


def _points(values: npt.ArrayLike, which: str) -> Floats:
    points = np.asarray(values, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise GeometryError(f"The {which} points have shape {points.shape}, must be (N, 3).", shape=points.shape)
    if not math.isfinite(np.add.reduce(points, None)):  # a single number that is not finite makes the sum not finite
        rows = np.flatnonzero(~np.isfinite(points).all(axis=1)).tolist()
        raise GeometryError(f"The {which} points {rows} hold a number that is not finite; measure again.", rows=rows)
    return points


def _weights(values: npt.ArrayLike, count: int) -> Floats:
    weights = np.asarray(values, dtype=float)
    if weights.shape != (count,) or not (np.isfinite(weights) & (weights >= 0.0)).all():
        text = f"The weights are {weights.tolist()}; give {count} finite numbers that are not negative."
        raise GeometryError(text, weights=weights.tolist(), count=count)
    return weights


def _covariances(values: npt.ArrayLike, weights: npt.ArrayLike | None, count: int) -> Floats:
    if weights is not None:
        raise GeometryError("Weights and covariances are both given; a covariance is a weight: give one of them.")
    return checked_covariances(values, count)


def checked_covariances(values: npt.ArrayLike, count: int) -> Floats:
    """Return covariances as an array (N, 3, 3), m^2.

    Args:
        values: Covariances, m^2, (N, 3, 3).
        count: Number N of points.

    Raises:
        GeometryError: A covariance is not symmetric and positive definite, or the shape is wrong.
    """
    covariances = np.asarray(values, dtype=float)
    if covariances.shape != (count, 3, 3) or not np.isfinite(covariances).all():
        text = f"The covariances have shape {covariances.shape}; give {count} finite matrices (3, 3)."
        raise GeometryError(text, shape=covariances.shape, count=count)
    symmetric = np.isclose(covariances, covariances.swapaxes(1, 2), rtol=1e-9, atol=0.0).all(axis=(1, 2))
    wrong = np.flatnonzero(~symmetric | (np.linalg.eigvalsh(covariances)[:, 0] <= 0.0)).tolist()
    if wrong:
        text = (
            f"The covariances of points {wrong} are not symmetric and positive definite; noise has some in each axis."
        )
        raise GeometryError(text, rows=wrong)
    return covariances


def _check_count(moving: Floats, weights: Floats | None) -> None:
    counted = moving if weights is None else moving[weights > 0.0]
    if len(counted) < MIN_POINTS:
        values = np.zeros(3)
        if len(counted):
            found = np.linalg.svd(counted - counted.mean(axis=0), compute_uv=False)
            values[: len(found)] = found
        raise DegeneratePointsError(
            f"The points are {len(counted)}, at least {MIN_POINTS} are needed; choose points that span a triangle.",
            count=len(counted),
            limit=MIN_POINTS,
            singular_values=values.tolist(),
        )


def _check_spread(centred: Floats, weights: Floats | None, which: str) -> Floats:
    """Return the singular values of points about their centroid, m, (3,); each point counts by its share of the weight.

    Raises:
        DegeneratePointsError: The points do not determine a rotation.
    """
    count = len(centred)
    if weights is not None:
        # Weights are scaled to a mean of 1, so that the limits do not depend on their scale.
        centred = centred * np.sqrt(weights * (count / weights.sum()))[:, None]
    values: Floats = np.asarray(np.linalg.svd(centred, compute_uv=False), dtype=float)
    first, second, _ = values.tolist()
    if first < MIN_SPREAD * math.sqrt(count):
        problem = f"coincide within {first / math.sqrt(count) * 1e3:.3g} mm, limit {MIN_SPREAD * 1e3:g} mm"
    elif second < MIN_SHAPE * first:
        problem = f"lie on a line (ratio of singular values {second / first:.3g}, limit {MIN_SHAPE:g})"
    else:
        return values
    raise DegeneratePointsError(
        f"The {which} points {problem}; choose points that span a triangle.",
        points=which,
        count=count,
        singular_values=values.tolist(),
    )


def _check_mirror(fit: RigidFit, squares: Floats, weights: Floats | None, singular_values: Floats) -> float:
    """Return the ratio of the rms residuals of the best rotation and the best reflection.

    Raises:
        MirroredPointsError: The ratio is above `MIRROR_RATIO`.
    """
    total = len(squares) if weights is None else float(weights.sum())
    sum_of_squares = float(np.add.reduce(squares) if weights is None else weights @ squares)
    rms = math.sqrt(sum_of_squares / total)
    # The best reflection differs from the best rotation in the sign of the smallest singular value only; see
    # `RigidFit`.
    mirrored_rms = math.sqrt(max(sum_of_squares + 4.0 * fit.smallest, 0.0) / total)
    ratio = rms / max(mirrored_rms, MIRROR_FLOOR)
    if ratio > MIRROR_RATIO:
        raise MirroredPointsError(
            f"A mirror image fits the points with {mirrored_rms * 1e3:.2f} mm rms, the best rotation only with "
            f"{rms * 1e3:.2f} mm, more than {MIRROR_RATIO:g} times as much: an image is flipped (was one axis "
            "reversed, as where LAS is read as RAS?) or left and right points are exchanged. Check the sides, then "
            "measure again.",
            rms=rms,
            mirrored_rms=mirrored_rms,
            ratio=ratio,
            limit=MIRROR_RATIO,
            singular_values=singular_values.tolist(),
        )
    return ratio
