"""Choice among the postures of a closed form: all branches at many values of the free joint, scored at once.

A closed form computes, for each column, a few values per joint, as rows. A branch takes one row for each joint. Sums
over the joints of a branch are then one product of matrices, and rows that branches share are scored once.
"""

from __future__ import annotations

from math import degrees

import numpy as np
import numpy.typing as npt

from pcmrs.errors import UnreachableError
from pcmrs.kinematics._least_squares import TOLERANCE, damped_least_squares
from pcmrs.kinematics._posture import DETOUR, LIMIT_COMFORT, comfort_penalty
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform

FORBIDDEN = 1e3
"""Cost of a posture beyond a limit, so that it ranks behind all others."""

ROUNDING = 1e-10
"""Excess over a limit that rounding may produce, rad; `inverse` takes it away."""


class Branches:
    """Rows that make up the posture of each branch.

    Args:
        rows: Row of each joint in each branch, (B, n).

    Attributes:
        rows: Row of each joint in each branch, (B, n).
        joints: Joint of each row, (R,).
    """

    def __init__(self, rows: npt.ArrayLike) -> None:
        self.rows = np.asarray(rows)
        branches, joints = self.rows.shape
        self.joints = np.zeros(self.rows.max() + 1, dtype=int)
        self.joints[self.rows] = np.arange(joints)
        self._sum = np.zeros((branches, len(self.joints)))
        self._sum[np.arange(branches)[:, None], self.rows] = 1.0

    def scores(self, arm: ArmModel, values: Floats, seed: Floats, joint_margin: float, shared: Floats) -> Floats:
        """Return the cost of every branch in every column, rad, (B, N).

        Beyond the limits it is `FORBIDDEN` plus the sum of the excess, rad.

        Args:
            arm: Model of the arm.
            values: Joint positions, rad, (R, N).
            seed: Joint positions to stay close to, rad, (n,).
            joint_margin: Distance to keep from every joint limit, rad.
            shared: Cost that all branches of a column share, rad, (N,).
        """
        lower, upper, near = (bound[self.joints, None] for bound in (arm.lower, arm.upper, seed))
        slack = np.minimum(values - lower, upper - values)
        scores: Floats = (
            np.sqrt(self._sum @ np.square(values - near))
            + DETOUR * (self._sum @ comfort_penalty(slack, LIMIT_COMFORT))
            + shared
        )
        beyond = self._sum @ np.maximum(0.0, joint_margin - ROUNDING - slack)
        return np.where(beyond > 0.0, FORBIDDEN + beyond, scores)

    def posture(self, values: Floats, branch: int, column: int) -> Floats:
        """Return the joint positions of a branch in a column, rad, (n,).

        Args:
            values: Joint positions, rad, (R, N).
            branch: Index of the branch.
            column: Index of the column.
        """
        posture: Floats = values[self.rows[branch], column]
        return posture


def flipped(values: Floats) -> Floats:
    """Return each joint position of a spherical shoulder or wrist as it is if its middle joint turns the other way.

    Args:
        values: Joint positions in [-pi, pi], rad, (R, N). Rows with an odd index are those of joints in the middle.
    """
    turned = -values
    turned[::2] = values[::2] - np.copysign(np.pi, values[::2])
    return turned


def settled(arm: ArmModel, base_from_flange: Transform, posture: Floats, joint_margin: float) -> Floats:
    """Return a posture within the limits that reaches the pose, next to one that breaks them, rad, (n,).

    If several joints are at their limits at once, only a single position of the free joint is allowed, which no scan
    meets.

    Args:
        arm: Model of the arm.
        base_from_flange: Pose of the flange to reach, in the robot's base.
        posture: Posture that reaches the pose and is the least beyond the limits, rad, (n,).
        joint_margin: Distance to keep from every joint limit, rad.

    Raises:
        UnreachableError: There is none; the text names the joint that is farthest beyond its limit.
    """
    lower, upper = arm.lower + joint_margin, arm.upper - joint_margin
    q, error = damped_least_squares(arm, base_from_flange, posture, lower, upper)
    if error @ error <= TOLERANCE**2:
        return q
    raise limit_error(arm, posture, joint_margin)


def too_far(reach: float, limit: float) -> UnreachableError:
    """Return the error for a pose that the stretched arm does not reach.

    Args:
        reach: Least distance of the wrist from the shoulder in the pose, m.
        limit: Their distance when the arm is stretched, m.
    """
    return UnreachableError(
        f"The pose is too far: the wrist would be {reach:.4f} m from the shoulder, the stretched arm reaches "
        f"{limit:.4f} m; bring it {(reach - limit) * 1e3:.1f} mm closer.",
        reach=reach,
        limit=limit,
    )


def limit_error(arm: ArmModel, posture: Floats, joint_margin: float) -> UnreachableError:
    """Return the error that names the joint which a posture puts farthest beyond its limit.

    Args:
        arm: Model of the arm.
        posture: Posture that reaches the pose and is the least beyond the limits, rad, (n,).
        joint_margin: Distance to keep from every joint limit, rad.
    """
    worst = int(np.argmax(np.maximum(posture - arm.upper, arm.lower - posture)))
    joint, position = arm.facts.joints[worst], float(posture[worst])
    return UnreachableError(
        f"Every posture that reaches the pose breaks a joint limit; the best one would put {joint.name} at "
        f"{degrees(position):.2f} deg, limits {degrees(joint.lower):.0f} to {degrees(joint.upper):.0f} deg with a "
        f"margin of {degrees(joint_margin):.1f} deg; move or turn the pose.",
        joint=joint.name,
        position=position,
        lower=joint.lower + joint_margin,
        upper=joint.upper - joint_margin,
    )
