"""Damped least squares: from a posture towards a pose within the joint limits."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform

TOLERANCE = 1e-10  # m and rad between the reached and the desired pose
_ITERATIONS = 100
_PATIENCE = 6  # steps without a reduction of the squared error by a tenth, after which the search ends
_DAMPING = 0.1  # share of the squared error; a fifth of Sugihara's value halves the number of steps to random targets
_IDENTITY = np.eye(6)

_Bools = npt.NDArray[np.bool_]


def damped_least_squares(
    arm: ArmModel, base_from_flange: Transform, start: Floats, lower: Floats, upper: Floats
) -> tuple[Floats, Floats]:
    """Go from a posture towards a pose, within limits, until the error is below `TOLERANCE` or no longer falls.

    Every step is the shortest joint motion for the remaining error, so that the posture stays near `start`. The damping
    vanishes with the error (T. Sugihara, Solvability-Unconcerned Inverse Kinematics by the Levenberg-Marquardt Method,
    IEEE Transactions on Robotics 27, 2011).

    Args:
        arm: Model of the arm.
        base_from_flange: Pose of the flange to reach, in the robot's base.
        start: Joint positions to start from, rad, (n,).
        lower: Lowest joint positions, rad, (n,).
        upper: Highest joint positions, rad, (n,).

    Returns:
        The last joint positions, rad, (n,), and the remaining error, m and rad, (6,).
    """
    q: Floats = np.clip(start, lower, upper)
    best, best_at = np.inf, 0
    for iteration in range(_ITERATIONS):
        error, jacobian = arm.pose_error_and_jacobian(base_from_flange, q)
        square = float(error @ error)
        if square < 0.9 * best:
            best, best_at = square, iteration
        if square <= TOLERANCE**2 or iteration - best_at >= _PATIENCE:
            break
        q = np.clip(q + _step(jacobian, error, square, q <= lower, q >= upper), lower, upper)
    return q, error


def _step(jacobian: Floats, error: Floats, square: float, at_lower: _Bools, at_upper: _Bools) -> Floats:
    """Return the damped step, rad, (n,). Joints that would leave their limits stay, and the others take over."""
    step = _solve(jacobian, error, square)
    blocked = (at_lower & (step < 0.0)) | (at_upper & (step > 0.0))
    if blocked.any():
        jacobian[:, blocked] = 0.0
        step = _solve(jacobian, error, square)
    return step


def _solve(jacobian: Floats, error: Floats, square: float) -> Floats:
    # The constant keeps the matrix invertible when the error, and with it the damping, vanishes.
    step: Floats = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + (_DAMPING * square + 1e-12) * _IDENTITY, error)
    return step
