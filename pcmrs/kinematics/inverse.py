"""Inverse kinematics: the joint positions of least cost that bring the flange to a pose."""

from __future__ import annotations

from math import degrees

import numpy as np
import numpy.typing as npt

from pcmrs.errors import UnreachableError
from pcmrs.kinematics import _numeric, _panda, _srs, _ur
from pcmrs.kinematics._geometry import PandaGeometry, SrsGeometry, UrGeometry
from pcmrs.kinematics._posture import sphere_array
from pcmrs.kinematics.limits import joint_array
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform

__all__ = ["inverse"]


def inverse(
    arm: ArmModel,
    base_from_flange: Transform,
    seed: npt.ArrayLike,
    *,
    joint_margin: float = 0.0,
    keep_away: npt.ArrayLike | None = None,
) -> Floats:
    """Return joint positions within the limits that reach a pose at the least cost, rad, (n,).

    The cost is that of `pcmrs.kinematics._posture`. Arms with one of the geometries of `pcmrs.kinematics._geometry` are
    solved in closed form: the best of all branches, for an arm of seven joints over a scan of its free joint or arm
    angle that is refined around the best one. All other arms are solved by damped least squares from the seed and from
    random postures: the first comfortable posture, or else the best of those found. The same arguments always give the
    same answer.

    Args:
        arm: Model of the arm.
        base_from_flange: Pose of the flange to reach, in the robot's base.
        seed: Joint positions to stay close to, rad, (n,).
        joint_margin: Distance to keep from every joint limit, rad.
        keep_away: Spheres that the forearm should keep away from, such as the head: rows of x, y, z and radius in the
            robot's base, m, (M, 4). This is a cost, not a collision check.

    Raises:
        GeometryError: `seed` does not hold one finite number per joint.
        UnreachableError: The pose is too far or too near, or no posture was found that keeps the joint limits and the
            margin.
    """
    near = joint_array(seed, arm.joints)
    _check_margin(arm, joint_margin)
    spheres = None if keep_away is None else sphere_array(keep_away)
    match arm.geometry:
        case SrsGeometry() as geometry:
            q = _srs.solve(arm, geometry, base_from_flange, near, joint_margin, spheres)
        case UrGeometry() as geometry:
            q = _ur.solve(arm, geometry, base_from_flange, near, joint_margin, spheres)
        case PandaGeometry() as geometry:
            q = _panda.solve(arm, geometry, base_from_flange, near, joint_margin, spheres)
        case None:
            q = _numeric.solve(arm, base_from_flange, near, joint_margin, spheres)
    return np.minimum(np.maximum(q, arm.lower + joint_margin), arm.upper - joint_margin)  # np.clip takes long


def _check_margin(arm: ArmModel, joint_margin: float) -> None:
    half = (arm.upper - arm.lower) / 2.0
    narrowest = int(np.argmin(half))
    if joint_margin >= half[narrowest]:
        raise UnreachableError(
            f"A margin of {degrees(joint_margin):.1f} deg leaves {arm.facts.joints[narrowest].name} no range; it must "
            f"be below {degrees(half[narrowest]):.1f} deg.",
            joint_margin=joint_margin,
            limit=float(half[narrowest]),
        )
