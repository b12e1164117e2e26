"""Inverse kinematics in closed form for arms with spherical shoulder, elbow and spherical wrist (S-R-S).

The hand pose fixes the wrist; the elbow may then turn about the line from shoulder to wrist by the arm angle.
For each arm angle the joints follow in closed form, in eight branches: the signs of joints 2, 4 and 6. After
M. Shimizu et al., Analytical Inverse Kinematic Computation for 7-DOF Redundant Manipulators With Joint Limits,
IEEE Transactions on Robotics 24 (2008), with the elbow found as a point on its circle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import atan2, cos, degrees, pi, sin

import numpy as np

from pcmrs.errors import UnreachableError
from pcmrs.kinematics._branches import FORBIDDEN, ROUNDING, Branches, flipped, settled, too_far
from pcmrs.kinematics._geometry import SrsGeometry
from pcmrs.kinematics._posture import (
    DETOUR,
    KEEP_AWAY_COMFORT,
    SINGULAR_COMFORT,
    comfort_penalty,
    sphere_distances,
)
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform

STRETCH_TOLERANCE = 1e-9  # m beyond the stretched arm that rounding may produce
_SINGULAR = 1e-12  # sine of a tilt angle below which the direction of the tilt is undefined
_SCANS = (90, 30, 30, 30)  # half the number of steps of each scan around the best arm angle of the previous scan

# If joint 2, 4 or 6 turns the other way, the joints beside it turn by half a turn. `_FLIPPED` marks the joints that
# this changes in each of the eight branches, (8, 7).
_FLIPPED = np.array([(a, a, a ^ b, b, b ^ c, c, c) for a, b, c in product((False, True), repeat=3)])
_BRANCHES = Branches(np.arange(7) + 7 * _FLIPPED)


@dataclass(frozen=True, eq=False)
class _ElbowCircle:
    """Circle of the elbow about the line from shoulder to wrist, in a frame at the shoulder with the axes of the base.

    Attributes:
        wrist: Position of the wrist, m, (3,).
        center: Center of the circle, m, (3,).
        radius: Radius of the circle, m.
        axes: Two unit vectors that span the plane of the circle, as rows, (2, 3).
        bend: Angle between upper arm and forearm, 0 if the arm is stretched, rad.
    """

    wrist: Floats
    center: Floats
    radius: float
    axes: Floats
    bend: float


def solve(
    arm: ArmModel,
    geometry: SrsGeometry,
    base_from_flange: Transform,
    seed: Floats,
    joint_margin: float,
    keep_away: Floats | None,
) -> Floats:
    """Return the posture of least cost, rad, (7,).

    Args:
        arm: Model of the arm.
        geometry: Geometry of the arm.
        base_from_flange: Pose of the flange to reach, in the robot's base.
        seed: Joint positions to stay close to, rad, (7,).
        joint_margin: Distance to keep from every joint limit, rad.
        keep_away: Spheres as returned by `pcmrs.kinematics._posture.sphere_array`, m, (M, 4), or None.

    Raises:
        UnreachableError: The pose is too far or too near, or no posture keeps the joint limits.
    """
    circle = _elbow_circle(arm, geometry, base_from_flange)
    center, step = _arm_angle(seed, circle), pi
    for scan, count in enumerate(_SCANS):
        angles = center + np.linspace(-step, step, 2 * count + 1)
        elbow = circle.center + circle.radius * (np.array((np.cos(angles), np.sin(angles))).T @ circle.axes)
        postures = _postures(circle, elbow.T, base_from_flange.rotation, seed)
        values = np.concatenate((postures, flipped(postures)))
        shared = DETOUR * _shared(postures, elbow + geometry.shoulder, circle.wrist + geometry.shoulder, keep_away)
        score = _BRANCHES.scores(arm, values, seed, joint_margin, shared)
        branch, column = divmod(int(np.argmin(score)), len(angles))
        center, step = float(angles[column]), step / count
        allowed = score[branch, column] < FORBIDDEN
        if scan and allowed:  # the last, finer scans only search for a narrow interval between the limits
            break
    best = _BRANCHES.posture(values, branch, column)
    return best if allowed else settled(arm, base_from_flange, best, joint_margin)


def _shared(postures: Floats, elbow: Floats, wrist: Floats, keep_away: Floats | None) -> Floats:
    """Return the penalties that all branches share, (N,): at singularities, and of the forearm near the spheres.

    Args:
        postures: Joint positions in one branch, rad, (7, N).
        elbow: Positions of the elbow in the base, m, (N, 3).
        wrist: Position of the wrist in the base, m, (3,).
        keep_away: Spheres in the base, m, (M, 4), or None.
    """
    short: Floats = comfort_penalty(np.abs(postures[1::2]), SINGULAR_COMFORT).sum(axis=0)
    if keep_away is not None:
        ends = np.broadcast_to(wrist, elbow.shape)
        short += comfort_penalty(sphere_distances(elbow, ends, keep_away), KEEP_AWAY_COMFORT).sum(axis=1)
    return short


def _elbow_circle(arm: ArmModel, geometry: SrsGeometry, base_from_flange: Transform) -> _ElbowCircle:
    """Return the circle of the elbow for a flange pose.

    Raises:
        UnreachableError: The wrist is too far from the shoulder, or so near that the elbow would bend beyond its limit.
    """
    _, shoulder, _, elbow, _, hand, _, flange = geometry.heights.tolist()
    upper_arm, forearm = elbow - shoulder, hand - elbow
    bend_limit = float(max(arm.upper[3], -arm.lower[3]))
    wrist = base_from_flange @ np.array((0.0, 0.0, hand - flange)) - geometry.shoulder
    reach = float(np.linalg.norm(wrist))
    if reach > upper_arm + forearm + STRETCH_TOLERANCE:
        raise too_far(reach, upper_arm + forearm)
    # The bend by the tangent of its half, and the radius by the area of the triangle (Heron): both are exact for the
    # stretched arm, too.
    stretched = max(0.0, (upper_arm + forearm - reach) * (upper_arm + forearm + reach))
    folded = max(0.0, (reach - upper_arm + forearm) * (reach + upper_arm - forearm))
    bend = 2.0 * atan2(stretched**0.5, folded**0.5)
    if bend > bend_limit + ROUNDING:
        raise UnreachableError(
            f"The pose is too near: with the wrist {reach:.4f} m from the shoulder {arm.facts.joints[3].name} would "
            f"bend {degrees(bend):.1f} deg, limit {degrees(bend_limit):.1f} deg; move it away from the shoulder.",
            reach=reach,
            bend=bend,
            limit=bend_limit,
        )
    direction = wrist / reach
    along = (reach**2 + upper_arm**2 - forearm**2) / (2.0 * reach)
    radius = (stretched * folded) ** 0.5 / (2.0 * reach)
    return _ElbowCircle(wrist, along * direction, radius, _perpendicular(direction), bend)


def _perpendicular(direction: Floats) -> Floats:
    """Return two unit vectors perpendicular to a unit vector and to each other, as rows, (2, 3)."""
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    return np.array((first, np.cross(direction, first)))


def _arm_angle(q: Floats, circle: _ElbowCircle) -> float:
    """Return the arm angle, rad, whose elbow lies in the direction of the elbow at joint positions `q`, rad, (7,)."""
    elbow = np.array((cos(q[0]) * sin(q[1]), sin(q[0]) * sin(q[1]), cos(q[1])))
    first, second = circle.axes @ elbow
    return atan2(second, first)


def _postures(circle: _ElbowCircle, elbow: Floats, rotation: Floats, near: Floats) -> Floats:
    """Return joint positions in the branch + - + of joints 2, 4, 6 for elbows (3, N), each in [-pi, pi], (7, N).

    The rotation is base_from_flange = Rz(q1) Ry(q2) Rz(q3) Ry(-q4) Rz(q5) Ry(q6) Rz(q7). x3, for example, is the x
    axis after the third of these. If an axis is undefined, as when the upper arm is upright, the first joint of the
    pair stays as in `near`.
    """
    q1, sine = _azimuth(elbow[0], elbow[1], near[0])
    q2 = np.arctan2(sine, elbow[2])
    c1, s1, c2, s2 = np.cos(q1), np.sin(q1), np.cos(q2), np.sin(q2)
    x2 = np.array((c1 * c2, s1 * c2, -s2))
    y2 = np.array((-s1, c1, np.zeros_like(c1)))
    z2 = np.array((c1 * s2, s1 * s2, c2))
    forearm = circle.wrist[:, None] - elbow
    q3, _ = _azimuth(np.einsum("in,in->n", x2, forearm), np.einsum("in,in->n", y2, forearm), near[2])
    c3, s3, c4, s4 = np.cos(q3), np.sin(q3), cos(circle.bend), sin(circle.bend)
    x3, y4 = c3 * x2 + s3 * y2, c3 * y2 - s3 * x2
    x, y, z = rotation.T
    x4, z4 = c4 * x3 - s4 * z2, s4 * x3 + c4 * z2
    q5, sine = _azimuth(z @ x4, z @ y4, near[4])
    q6 = np.arctan2(sine, z @ z4)
    y5 = np.cos(q5) * y4 - np.sin(q5) * x4
    q7 = np.arctan2(x @ y5, y @ y5)
    return np.array((q1, q2, q3, np.full_like(q1, -circle.bend), q5, q6, q7))


def _azimuth(x: Floats, y: Floats, if_upright: float) -> tuple[Floats, Floats]:
    """Return the direction, rad, and the length of plane vectors, (N,) each; without a direction, `if_upright`."""
    length = np.sqrt(x * x + y * y)
    return np.where(length > _SINGULAR, np.arctan2(y, x), if_upright), length
