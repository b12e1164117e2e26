"""Most likely rigid transform if the noise differs between points and between directions.

N. Ohta, K. Kanatani, Optimal Estimation of Three-Dimensional Rotation and Reliability Evaluation, ECCV 1998;
R. Balachandran, J. M. Fitzpatrick, Iterative Solution for Rigid-Body Point-Based Registration with Anisotropic
Weighting, SPIE Medical Imaging 2009. Solved here by Gauss-Newton steps on the motion group.
"""

from __future__ import annotations

import numpy as np

from pcmrs.errors import GeometryError
from pcmrs.registration.rigid import RigidFit, motion_jacobians
from pcmrs.spatial import Floats, Transform, trusted_transform

MAX_STEPS = 100
SMALL_STEP = 1e-12  # rad and m


def fit_anisotropic(fixed: Floats, moving: Floats, covariances: Floats, start: RigidFit) -> Transform:
    """Return the ``fixed_from_moving`` with the least sum of ``d_i^T C_i^-1 d_i`` over the pairs' differences d_i.

    Args:
        fixed: Points in the fixed frame, m, (N, 3).
        moving: The same points in the moving frame, m, (N, 3).
        covariances: Covariances of the fixed points' noise in the fixed frame, positive definite, m^2, (N, 3, 3).
        start: Fit without covariances, from which the steps start.

    Raises:
        GeometryError: The steps do not converge, because the covariances are too unequal for these points.
    """
    inverses = inverse_covariances(covariances)
    origin = moving.mean(axis=0)  # rotating about the centroid decouples rotation and translation
    rotation, shifted = start.rotation, start.rotation @ origin + start.translation
    for _ in range(MAX_STEPS):
        turned = (moving - origin) @ rotation.T
        step = _step(turned, fixed - turned - shifted, inverses)
        rotation, shifted = Transform.from_rotvec(np.zeros(3), step[:3]).rotation @ rotation, shifted + step[3:]
        if np.abs(step).max() < SMALL_STEP:
            return trusted_transform(rotation, shifted - rotation @ origin)
    text = f"The registration with covariances did not settle in {MAX_STEPS} steps; give noise that is less unequal."
    raise GeometryError(text, steps=MAX_STEPS, last_step=float(np.abs(step).max()))


def inverse_covariances(covariances: Floats) -> Floats:
    """Return the inverse of each covariance matrix, 1/m^2, (N, 3, 3)."""
    return np.asarray(np.linalg.inv(covariances), dtype=np.float64)


def _step(turned: Floats, residuals: Floats, inverses: Floats) -> Floats:
    """Return the small motion ``(rotation vector, translation)`` that reduces the sum most, rad and m, (6,)."""
    jacobians = motion_jacobians(turned)
    weighted = jacobians.swapaxes(1, 2) @ inverses
    # The step of least norm, because points on a line can turn about it without any change of their distances.
    step: Floats = np.linalg.lstsq((weighted @ jacobians).sum(axis=0), np.einsum("nij,nj->i", weighted, residuals))[0]
    return step
