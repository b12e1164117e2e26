"""Inverse kinematics of any serial arm by damped least squares from the seed, near it and from random postures.

Only arms without a closed form need this search, such as those of users and arms with calibrated dimensions.
"""

from __future__ import annotations

from math import tau

import numpy as np

from pcmrs.errors import UnreachableError
from pcmrs.kinematics._least_squares import TOLERANCE, damped_least_squares
from pcmrs.kinematics._posture import LIMIT_COMFORT, cost
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform

_RESTARTS = 50
_SOLUTIONS = 4  # number of solutions compared if none is comfortable


def solve(
    arm: ArmModel, base_from_flange: Transform, seed: Floats, joint_margin: float, keep_away: Floats | None
) -> Floats:
    """Return the posture of least cost among those found, rad, (n,).

    The first comfortable posture is returned; it is near the seed if the seed leads to one. If none of the first
    `_SOLUTIONS` postures is comfortable, the best of them is returned.

    Args:
        arm: Model of the arm.
        base_from_flange: Pose of the flange to reach, in the robot's base.
        seed: Joint positions to stay close to, rad, (n,).
        joint_margin: Distance to keep from every joint limit, rad.
        keep_away: Spheres as returned by `pcmrs.kinematics._posture.sphere_array`, m, (M, 4), or None.

    Raises:
        UnreachableError: No posture was found.
    """
    lower, upper = arm.lower + joint_margin, arm.upper - joint_margin
    # A fixed seed, so that the same arguments always give the same answer.
    restarts = np.random.default_rng(0).uniform(lower, upper, (_RESTARTS, arm.joints))
    found: list[tuple[float, Floats]] = []
    least_error = np.full(6, np.inf)
    comfortable_seed = np.clip(seed, lower + LIMIT_COMFORT, upper - LIMIT_COMFORT)
    for start in (seed, comfortable_seed, *restarts):
        q, error = damped_least_squares(arm, base_from_flange, start, lower, upper)
        least_error = min(least_error, error, key=np.linalg.norm)
        if error @ error <= TOLERANCE**2:
            q = _unwrapped(q, seed, lower, upper)
            found.append((cost(arm, q, seed, keep_away), q))
            comfortable = found[-1][0] == np.linalg.norm(q - seed)
            if comfortable or len(found) == _SOLUTIONS:
                break
    if not found:
        raise _error(arm, least_error, joint_margin)
    return min(found, key=lambda pair: pair[0])[1]


def _unwrapped(q: Floats, seed: Floats, lower: Floats, upper: Floats) -> Floats:
    """Turn joints that can turn more than once to their angle nearest to the seed within the limits, rad, (n,)."""
    near = q - tau * np.round((q - seed) / tau)
    near = near + tau * (np.where(near < lower, 1.0, 0.0) - np.where(near > upper, 1.0, 0.0))
    unwrapped: Floats = np.where((near >= lower) & (near <= upper), near, q)
    return unwrapped


def _error(arm: ArmModel, least_error: Floats, joint_margin: float) -> UnreachableError:
    gap, turn = float(np.linalg.norm(least_error[:3])), float(np.linalg.norm(least_error[3:]))
    return UnreachableError(
        f"No posture of {arm.facts.name} was found that reaches the pose with a margin of "
        f"{np.degrees(joint_margin):.1f} deg from every joint limit; the nearest of {_RESTARTS + 2} tries stayed "
        f"{gap * 1e3:.1f} mm and {np.degrees(turn):.1f} deg away. Move or turn the pose.",
        gap=gap,
        turn=turn,
    )
