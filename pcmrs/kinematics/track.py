"""Inverse kinematics for small steps: damped least squares from the present posture."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from pcmrs.errors import UnreachableError
from pcmrs.kinematics.joints import joint_array
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform

TOLERANCE = 1e-10  # m and rad between the pose reached and the pose asked for
_ITERATIONS = 100


def track(arm: ArmModel, base_from_flange: Transform, seed: npt.ArrayLike) -> Floats:
    """Joint positions within the limits that reach the pose by small steps from `seed`, rad, (7,).

    Every step is the shortest joint motion for what is left of the way, so that the posture stays near `seed`;
    its damping vanishes with the error (T. Sugihara, Solvability-Unconcerned Inverse Kinematics by the
    Levenberg-Marquardt Method, IEEE Transactions on Robotics 27, 2011).

    Args:
        arm: The arm.
        base_from_flange: The pose to reach, near that of `seed`.
        seed: Joint positions to start from, rad, (7,).

    Raises:
        GeometryError: `seed` does not hold seven finite numbers.
        UnreachableError: The steps end before the pose: at a joint limit or at the edge of the workspace.
    """
    q: Floats = np.clip(joint_array(seed), arm.lower, arm.upper)
    error = _error(arm, base_from_flange, q)
    for _ in range(_ITERATIONS):
        if np.linalg.norm(error) <= TOLERANCE:
            return q
        q = np.clip(q + _step(arm, q, error), arm.lower, arm.upper)
        error = _error(arm, base_from_flange, q)
    gap, turn = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
    raise UnreachableError(
        f"The arm cannot follow to the pose: it stops {gap * 1e3:.3f} mm and {np.degrees(turn):.3f} deg before it, at "
        "a joint limit or at the edge of its workspace; choose another posture to start from or another pose.",
        gap=gap,
        turn=turn,
        positions=q.tolist(),
    )


def _error(arm: ArmModel, base_from_flange: Transform, q: Floats) -> Floats:
    """What is left of the way: translation (m) and rotation vector (rad) along the axes of the base, (6,)."""
    reached = arm.forward(q)
    turn = Rotation.from_matrix(base_from_flange.rotation @ reached.rotation.T).as_rotvec()
    return np.concatenate((base_from_flange.translation - reached.translation, turn))


def _step(arm: ArmModel, q: Floats, error: Floats) -> Floats:
    """The damped step; joints that would leave their limits stay and the others take over."""
    jacobian = arm.jacobian(q)
    step = _solve(jacobian, error)
    blocked = ((q <= arm.lower) & (step < 0.0)) | ((q >= arm.upper) & (step > 0.0))
    if blocked.any():
        jacobian[:, blocked] = 0.0
        step = _solve(jacobian, error)
    return step


def _solve(jacobian: Floats, error: Floats) -> Floats:
    damping = float(error @ error) + 1e-12
    step: Floats = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(6), error)
    return step
