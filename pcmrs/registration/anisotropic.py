"""The most likely rigid transform when the noise differs between points and between directions.

N. Ohta, K. Kanatani, Optimal Estimation of Three-Dimensional Rotation and Reliability Evaluation, ECCV 1998;
R. Balachandran, J. M. Fitzpatrick, Iterative Solution for Rigid-Body Point-Based Registration with Anisotropic
Weighting, SPIE Medical Imaging 2009. Here by Gauss-Newton steps on the motion group.
"""

from __future__ import annotations

import numpy as np

from pcmrs.errors import GeometryError
from pcmrs.registration.rigid import RigidFit, motion_jacobians
from pcmrs.spatial import Floats, Transform, trusted_transform

MAX_STEPS = 100
SMALL_STEP = 1e-12  # rad and m


def fit_anisotropic(fixed: Floats, moving: Floats, covariances: Floats, start: RigidFit) -> Transform:
    """``fixed_from_moving`` with the least sum of ``d_i^T C_i^-1 d_i`` over the pairs' differences d_i.

    Args:
        fixed: m, (N, 3).
        moving: m, (N, 3).
        covariances: Of the fixed points' noise in the fixed frame, positive definite, m^2, (N, 3, 3).
        start: The fit that knows nothing of them.

    Raises:
        GeometryError: The steps do not become small: the covariances are too unequal for these points.
    """
    inverses = inverse_of(covariances)
    origin = moving.mean(axis=0)  # turning about it keeps rotation and translation apart
    rotation, shifted = start.rotation, start.rotation @ origin + start.translation
    for _ in range(MAX_STEPS):
        turned = (moving - origin) @ rotation.T
        step = _step(turned, fixed - turned - shifted, inverses)
        rotation, shifted = Transform.from_rotvec(np.zeros(3), step[:3]).rotation @ rotation, shifted + step[3:]
        if np.abs(step).max() < SMALL_STEP:
            return trusted_transform(rotation, shifted - rotation @ origin)
    text = f"The registration with covariances did not settle in {MAX_STEPS} steps; give noise that is less unequal."
    raise GeometryError(text, steps=MAX_STEPS, last_step=float(np.abs(step).max()))


def inverse_of(covariances: Floats) -> Floats:
    """Inverse of each matrix, 1/m^2, (N, 3, 3)."""
    return np.asarray(np.linalg.inv(covariances), dtype=np.float64)


def _step(turned: Floats, left: Floats, inverses: Floats) -> Floats:
    """The small motion ``(rotation vector, translation)`` that lowers the sum most, (6,)."""
    jacobians = motion_jacobians(turned)
    weighted = jacobians.swapaxes(1, 2) @ inverses
    # Of least length: points on a line may turn about it as they like, which leaves their distances as they are.
    step: Floats = np.linalg.lstsq((weighted @ jacobians).sum(axis=0), np.einsum("nij,nj->i", weighted, left))[0]
    return step
