"""Rigid transforms as OpenIGTLink has them: homogeneous matrices in mm, of single precision."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pcmrs.errors import RefusalError
from pcmrs.spatial import Floats, Transform

TOLERANCE = 1e-4
"""Greatest deviation of R R^T from I: what single precision and a chain of products leave, 0.006 degrees."""


def rigid(matrix_mm: npt.ArrayLike) -> Transform:
    """The transform, in m, of a matrix (4, 4) in mm; its rotation is the orthonormal one nearest to the matrix.

    The polar factor (Higham, Computing the Polar Decomposition, 1986), by singular values.

    Raises:
        RefusalError: ``not_finite``, ``mirrored``, or ``not_rigid`` with how far it is from a rotation.
    """
    matrix = np.array(matrix_mm, dtype=float)
    if not np.isfinite(matrix).all():
        raise RefusalError("not_finite", "The transform holds a number that is not finite; send a rigid transform.")
    rotation = matrix[:3, :3]
    deviation = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if deviation > TOLERANCE:
        text = f"R R^T differs from I by {deviation:.3g}, the limit is {TOLERANCE:g}: the transform scales or shears."
        raise RefusalError("not_rigid", f"{text} Send a rigid one.", deviation=deviation, limit=TOLERANCE)
    if np.linalg.det(rotation) < 0.0:
        raise RefusalError("mirrored", "The transform mirrors: its determinant is -1, a rotation's is +1.")
    left, _, right = np.linalg.svd(rotation)
    return Transform(left @ right, matrix[:3, 3] * 1e-3)


def matrix_mm(transform: Transform) -> Floats:
    """The homogeneous matrix of a transform, (4, 4), mm."""
    matrix = transform.matrix
    matrix[:3, 3] *= 1e3
    return matrix
