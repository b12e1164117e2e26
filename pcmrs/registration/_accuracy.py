"""Predicted error of a registration at a target: first-order propagation of the points' noise.

For equal isotropic noise and no weights this is the formula of J. M. Fitzpatrick, J. B. West, C. R. Maurer, Predicting
Error in Rigid-Body Point-Based Registration, IEEE TMI 17 (1998). Written as a propagation of covariances it holds for
weights and anisotropic noise, too (see A. Danilchenko, J. M. Fitzpatrick, General Approach to First-Order Error
Prediction in Rigid Point Registration, IEEE TMI 30 (2011)).
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError
from pcmrs.registration._anisotropic import inverse_covariances
from pcmrs.registration._points import checked_covariances, register_points
from pcmrs.registration.rigid import motion_jacobians
from pcmrs.spatial import Floats


def predict_tre(
    fiducials: npt.ArrayLike,
    targets: npt.ArrayLike,
    noise: float | npt.ArrayLike,
    *,
    weights: npt.ArrayLike | None = None,
) -> Floats:
    """Return the rms target registration error (TRE) that noise of the fiducials causes, m, (M,).

    The assumed fit is that of `register_points`: weighted if `weights` are given, whatever the noise is; otherwise
    plain for equal noise, and by likelihood for covariances. All points and covariances are in one frame.

    Args:
        fiducials: Positions of the registered points, m, (N, 3).
        targets: Positions at which the error is predicted, m, (M, 3) or (3,).
        noise: Standard deviation per axis, m, or the covariance of each fiducial, m^2, (N, 3, 3).
        weights: Weights that the fit uses, (N,).

    Raises:
        GeometryError: Shapes, weights or noise are wrong.
        DegeneratePointsError: The fiducials do not determine a rotation.
    """
    fiducials = np.asarray(fiducials, dtype=float)
    register_points(fiducials, fiducials, weights=weights)  # raises if no registration could use these points
    covariances, precisions = _noise(noise, weights, len(fiducials))
    targets = np.atleast_2d(np.asarray(targets, dtype=float))
    if targets.shape[1:] != (3,) or not np.isfinite(targets).all():
        raise GeometryError(f"The targets have shape {targets.shape}; give finite points (M, 3).", shape=targets.shape)
    # About the centroid, rotation and translation are decoupled, which keeps the digits.
    centre = fiducials.mean(axis=0)
    motion = _motion_covariance(fiducials - centre, covariances, precisions)
    jacobians = motion_jacobians(targets - centre)
    tre: Floats = np.sqrt(np.einsum("mij,jk,mik->m", jacobians, motion, jacobians))
    return tre


def _noise(noise: float | npt.ArrayLike, weights: npt.ArrayLike | None, count: int) -> tuple[Floats, Floats]:
    """Return the covariances of the points and the weight matrices of their differences in the fit, (N, 3, 3) each."""
    covariances = _equal_noise(float(np.asarray(noise)), count) if np.ndim(noise) == 0 else noise
    covariances = checked_covariances(covariances, count)
    if weights is not None:
        return covariances, np.asarray(weights, dtype=float)[:, None, None] * np.eye(3)
    return covariances, inverse_covariances(covariances)


def _equal_noise(sigma: float, count: int) -> Floats:
    if not 0.0 < sigma < math.inf:
        raise GeometryError(f"The noise of the fiducials is {sigma:g} m per axis; give a positive length.", noise=sigma)
    return np.tile(sigma**2 * np.eye(3), (count, 1, 1))


def _motion_covariance(points: Floats, covariances: Floats, precisions: Floats) -> Floats:
    """Return the covariance of the fitted motion's ``(rotation vector, translation)``, rad and m, (6, 6).

    For errors e_i of the points the least-squares motion is ``A^-1 sum(J_i^T W_i e_i)`` with ``A = sum(J_i^T W_i
    J_i)``.
    """
    jacobians = motion_jacobians(points)
    weighted = jacobians.swapaxes(1, 2) @ precisions
    gains = np.linalg.solve((weighted @ jacobians).sum(axis=0), weighted)
    covariance: Floats = (gains @ covariances @ gains.swapaxes(1, 2)).sum(axis=0)
    return covariance
