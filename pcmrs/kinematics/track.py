"""Inverse kinematics for small steps by damped least squares from the present posture."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from pcmrs.errors import UnreachableError
from pcmrs.kinematics._least_squares import TOLERANCE, damped_least_squares
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.limits import joint_array
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform

UnreachableReason = Literal["workspace", "joint_limit", "other_posture", "unknown"]
"""Why the arm cannot follow: no posture reaches the pose, every posture that does breaks a joint limit, only a posture
far from the present one does, or the arm has no closed form that could answer."""


def track(arm: ArmModel, base_from_flange: Transform, seed: npt.ArrayLike) -> Floats:
    """Return joint positions within the limits that reach the pose by small steps from `seed`, rad, (n,).

    Args:
        arm: Model of the arm.
        base_from_flange: Pose of the flange to reach, in the robot's base, near that of `seed`.
        seed: Joint positions to start from, rad, (n,).

    Raises:
        GeometryError: `seed` does not hold one finite number per joint.
        UnreachableError: The steps end before the pose. The text explains the field `reason`, an `UnreachableReason`.
    """
    start = joint_array(seed, arm.joints)
    q, error = damped_least_squares(arm, base_from_flange, start, arm.lower, arm.upper)
    if error @ error <= TOLERANCE**2:
        return q
    gap, turn = float(np.linalg.norm(error[:3])), float(np.linalg.norm(error[3:]))
    reason, text, fields = _reason(arm, base_from_flange, start)
    raise UnreachableError(
        f"The arm cannot follow to the pose: it stops {gap * 1e3:.3f} mm and {np.degrees(turn):.3f} deg before it. "
        f"{text}",
        **fields,
        reason=reason,
        gap=gap,
        turn=turn,
        positions=q.tolist(),
    )


def _reason(arm: ArmModel, base_from_flange: Transform, seed: Floats) -> tuple[UnreachableReason, str, dict[str, Any]]:
    """Return why small steps from `seed`, rad, (n,), do not reach a pose: the reason, its text, and its values."""
    if arm.geometry is None:  # the search takes too long for a control loop, and does not prove that there is none
        text = (
            "A joint limit, the edge of the workspace or a singular posture is in the way; start from another posture."
        )
        return "unknown", text, {}
    try:
        posture = inverse(arm, base_from_flange, seed)
    except UnreachableError as error:
        return "joint_limit" if "joint" in error.fields else "workspace", error.text, dict(error.fields)
    moves = np.abs(posture - seed)
    joint, move = arm.facts.joints[int(np.argmax(moves))].name, float(moves.max())
    text = f"Only another posture reaches it, with {joint} turned by {np.degrees(move):.0f} deg; plan a motion to it."
    return "other_posture", text, {"joint": joint, "move": move}
