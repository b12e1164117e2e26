"""Rigid transform between paired points in closed form, for one set or for many at once.

K. S. Arun, T. S. Huang, S. D. Blostein, Least-Squares Fitting of Two 3-D Point Sets, IEEE PAMI 9 (1987); the
reflection is handled after S. Umeyama, Least-Squares Estimation of Transformation Parameters Between Two Point
Patterns, IEEE PAMI 13 (1991). Nothing is checked here: `register_points` does that and spends most of its time here.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from pcmrs.spatial import Floats


class RigidFit(NamedTuple):
    """``fixed_from_moving`` as rotation and translation, and the points that it was computed from.

    Attributes:
        rotation: Rotation matrix, (3, 3).
        translation: Translation, m, (3,).
        smallest: Smallest singular value of the cross-covariance, m^2, negative if a reflection fits better. The
            reflection's sum of squares is that of the rotation plus four times this value.
        fixed: Fixed points relative to their centroid, m, (N, 3).
        moving: Moving points relative to their centroid, m, (N, 3).
    """

    rotation: Floats
    translation: Floats
    smallest: float
    fixed: Floats
    moving: Floats

    def squares(self) -> Floats:
        """Return the squared distance of each pair after the fit, m^2, (N,)."""
        remaining = self.moving.dot(self.rotation.T) - self.fixed
        squares: Floats = np.add.reduce(remaining * remaining, 1)
        return squares


def fit_rigid(fixed: Floats, moving: Floats, weights: Floats | None = None) -> RigidFit:
    """Return the rotation and translation that map `moving` onto `fixed` with the least weighted sum of squares.

    Args:
        fixed: Points in the fixed frame, m, (N, 3).
        moving: The same points in the moving frame, m, (N, 3).
        weights: Weights of the squared distances, not negative, (N,).
    """
    shares = _equal_shares(len(fixed)) if weights is None else weights / weights.sum()
    fixed_centroid, moving_centroid = shares.dot(fixed), shares.dot(moving)
    fixed, moving = fixed - fixed_centroid, moving - moving_centroid
    # `dot`: for matrices this small, calling takes longer than computing.
    covariance = fixed.T.dot(moving if weights is None else moving * weights[:, None])
    u, singular, vt = np.linalg.svd(covariance)
    smallest = float(singular[2])
    if (_determinant(u) < 0.0) != (_determinant(vt) < 0.0):
        # The sign goes to the smallest singular value: there a flip costs least, and nothing for coplanar points.
        u[:, 2] *= -1.0
        smallest = -smallest
    rotation = u.dot(vt)
    return RigidFit(rotation, fixed_centroid - rotation.dot(moving_centroid), smallest, fixed, moving)


@lru_cache
def _equal_shares(count: int) -> Floats:
    """Return the weights of a mean, (N,).

    They are cached, because computing them takes three times as long as a product with them.
    """
    shares = np.full(count, 1.0 / count)
    shares.flags.writeable = False
    return shares


def register_batch(fixed: Floats, moving: Floats) -> tuple[Floats, Floats]:
    """Return the unweighted fits of many sets at once, for Monte Carlo and leave-one-out.

    Args:
        fixed: Points of each set in the fixed frame, m, (B, N, 3).
        moving: Points in the moving frame, m, (N, 3) for all sets, or (B, N, 3).

    Returns:
        Rotations (B, 3, 3) and translations (B, 3), m, of ``fixed_from_moving``.
    """
    fixed_centroids, moving_centroids = fixed.mean(axis=-2), moving.mean(axis=-2)
    centred = moving - moving_centroids[..., None, :]
    u, _, vt = np.linalg.svd(fixed.swapaxes(-1, -2) @ centred)
    flipped = np.linalg.det(u) * np.linalg.det(vt) < 0.0
    u[flipped, :, 2] *= -1.0
    rotations: Floats = u @ vt
    translations: Floats = fixed_centroids - (rotations @ moving_centroids[..., None])[..., 0]
    return rotations, translations


def sums_of_squares(fixed: Floats, moving: Floats) -> Floats:
    """Return the least sum of squared distances of each set that a rigid transform leaves, m^2, (B,).

    Args:
        fixed: Points of each set in the fixed frame, m, (B, N, 3).
        moving: Points in the moving frame, m, (N, 3) for all sets, or (B, N, 3).
    """
    rotations, translations = register_batch(fixed, moving)
    remaining = moving @ rotations.swapaxes(-1, -2) + translations[:, None] - fixed
    squares: Floats = np.einsum("bni,bni->b", remaining, remaining)
    return squares


def cross_matrices(vectors: Floats) -> Floats:
    """Return ``[v]x`` of each vector (N, 3), so that ``[v]x w = v x w``, (N, 3, 3)."""
    matrices = np.zeros((len(vectors), 3, 3))
    x, y, z = vectors.T
    matrices[:, 0, 1], matrices[:, 0, 2], matrices[:, 1, 2] = -z, y, -x
    matrices[:, 1, 0], matrices[:, 2, 0], matrices[:, 2, 1] = z, -y, x
    return matrices


def motion_jacobians(points: Floats) -> Floats:
    """Return the derivatives of points (N, 3) by a small motion of their frame, (N, 3, 6).

    A motion is ``(rotation vector, translation)``, rad and m.
    """
    return np.concatenate((-cross_matrices(points), np.tile(np.eye(3), (len(points), 1, 1))), axis=2)


def _determinant(matrix: Floats) -> float:
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    return float(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))
