"""Inverse kinematics in closed form for arms with spherical shoulder, elbow and spherical wrist (S-R-S).

The hand pose fixes the wrist; the elbow may then turn about the line from shoulder to wrist by the arm angle.
For each arm angle the joints follow in closed form, in eight branches: the signs of joints 2, 4 and 6. After
M. Shimizu et al., Analytical Inverse Kinematic Computation for 7-DOF Redundant Manipulators With Joint Limits,
IEEE Transactions on Robotics 24 (2008), with the elbow found as a point on its circle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import acos, degrees, pi

import numpy as np
import numpy.typing as npt

from pcmrs.errors import UnreachableError
from pcmrs.kinematics.joints import joint_array
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform

STRETCH_TOLERANCE = 1e-9  # m beyond the stretched arm that rounding may produce
_SINGULAR = 1e-12  # sine of an angle below which the direction it tilts to is undefined
_BRANCHES = np.array(list(product((1.0, -1.0), repeat=3))).T[:, :, None]  # signs of joints 2, 4, 6: (3, 8, 1)


@dataclass(frozen=True)
class _Elbow:
    """The circle of the elbow about the line from shoulder to wrist, in the frame of the shoulder.

    Attributes:
        wrist: Position of the wrist, m, (3,).
        center: Of the circle, m, (3,).
        radius: Of the circle, m.
        axes: Two unit vectors that span its plane, as rows, (2, 3).
    """

    wrist: Floats
    center: Floats
    radius: float
    axes: Floats


def inverse(arm: ArmModel, base_from_flange: Transform, seed: npt.ArrayLike, *, joint_margin: float = 0.0) -> Floats:
    """Joint positions within the limits that reach the pose and lie closest to `seed`, rad, (7,).

    Args:
        arm: An S-R-S arm.
        base_from_flange: The pose to reach.
        seed: Joint positions to stay close to (Euclidean distance), rad, (7,).
        joint_margin: Distance to keep from every joint limit, rad.

    Raises:
        GeometryError: `seed` does not hold seven finite numbers.
        UnreachableError: The pose is too far, too near, or no posture keeps the joint limits.
    """
    near = joint_array(seed)
    lower, upper = arm.lower + joint_margin, arm.upper - joint_margin
    upper_arm, forearm, wrist = _wrist(arm, base_from_flange)
    circle = _elbow_circle(upper_arm, forearm, wrist, float(upper[3]))
    center, step = _arm_angle(near, circle), pi
    best, excess = near, np.full(7, np.inf)
    for count in (90, 20, 20):  # each scan refines around the best arm angle of the one before
        angles = center + np.linspace(-step, step, 2 * count + 1)
        postures = _postures(circle, base_from_flange.rotation, angles, near)
        excesses = np.maximum(postures - upper, lower - postures)
        worst = excesses.max(axis=-1)
        # Postures within the limits rank by distance; all others come after them, by how far they are out.
        score = np.where(worst > 0.0, 1e3 + worst, np.linalg.norm(postures - near, axis=-1))
        branch, column = np.unravel_index(np.argmin(score), score.shape)
        best, excess = postures[branch, column], excesses[branch, column]
        center, step = float(angles[column]), step / count
    if excess.max() > 0.0:
        raise _limit_error(arm, best, int(np.argmax(excess)), joint_margin)
    return best


def _wrist(arm: ArmModel, base_from_flange: Transform) -> tuple[float, float, Floats]:
    """Lengths of upper arm and forearm, and the position of the wrist from the shoulder, m."""
    _, shoulder, _, elbow, _, wrist, _, flange = arm.heights
    hand = np.array((0.0, 0.0, flange - wrist))
    position = base_from_flange @ -hand - np.array((0.0, 0.0, shoulder))
    return float(elbow - shoulder), float(wrist - elbow), position


def _elbow_circle(upper_arm: float, forearm: float, wrist: Floats, bend_limit: float) -> _Elbow:
    reach = float(np.linalg.norm(wrist))
    if reach > upper_arm + forearm + STRETCH_TOLERANCE:
        raise UnreachableError(
            f"The pose is too far: the wrist would be {reach:.4f} m from the shoulder, the stretched arm reaches "
            f"{upper_arm + forearm:.4f} m; bring it {(reach - upper_arm - forearm) * 1e3:.1f} mm closer.",
            reach=reach,
            limit=upper_arm + forearm,
        )
    cosine = (reach**2 - upper_arm**2 - forearm**2) / (2.0 * upper_arm * forearm)
    bend = acos(min(1.0, max(-1.0, cosine)))
    if bend > bend_limit:
        raise UnreachableError(
            f"The pose is too near: with the wrist {reach:.4f} m from the shoulder joint_4 would bend "
            f"{degrees(bend):.1f} deg, limit {degrees(bend_limit):.1f} deg; move it away from the shoulder.",
            reach=reach,
            bend=bend,
            limit=bend_limit,
        )
    direction = wrist / reach
    along = (reach**2 + upper_arm**2 - forearm**2) / (2.0 * reach)
    radius = max(0.0, upper_arm**2 - along**2) ** 0.5
    return _Elbow(wrist, along * direction, radius, _perpendicular(direction))


def _perpendicular(direction: Floats) -> Floats:
    """Two unit vectors perpendicular to a unit vector and to each other, as rows, (2, 3)."""
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    return np.array((first, np.cross(direction, first)))


def _arm_angle(q: Floats, circle: _Elbow) -> float:
    """The arm angle whose elbow lies in the direction of the elbow at joint positions `q`."""
    elbow = np.array((np.cos(q[0]) * np.sin(q[1]), np.sin(q[0]) * np.sin(q[1]), np.cos(q[1])))
    first, second = circle.axes @ elbow
    return float(np.arctan2(second, first))


def _postures(circle: _Elbow, rotation: Floats, angles: Floats, near: Floats) -> Floats:
    """Joint positions of all branches at all arm angles, (8, N, 7), each in [-pi, pi].

    With base_from_flange = Rz(q1) Ry(q2) Rz(q3) Ry(-q4) Rz(q5) Ry(q6) Rz(q7) for rotations. Where an axis is
    undefined, as when the upper arm is upright, the first joint of the pair stays as in `near`.
    """
    sign2, sign4, sign6 = _BRANCHES
    ring = np.array((np.cos(angles), np.sin(angles))).T @ circle.axes
    elbow = circle.center + circle.radius * ring
    q1, q2 = _azimuth_and_tilt(elbow.T, sign2, near[0])
    forearm = _turn_y(_turn_z((circle.wrist - elbow).T, -q1), -q2)
    q3, q4 = _azimuth_and_tilt(forearm, -sign4, near[2])
    # Columns x, y, z of the flange's rotation, seen from the frame after joint 4.
    x, y, z = (_turn_y(_turn_z(_turn_y(_turn_z(c[:, None], -q1), -q2), -q3), -q4) for c in rotation.T)
    q5, q6 = _azimuth_and_tilt(z, sign6, near[4])
    q7 = np.arctan2(_turn_z(x, -q5)[1], _turn_z(y, -q5)[1])
    return np.stack(np.broadcast_arrays(q1, q2, q3, -q4, q5, q6, q7), axis=-1)


def _azimuth_and_tilt(vector: Floats, sign: Floats, azimuth_if_upright: float) -> tuple[Floats, Floats]:
    """Angles a, b with b of the given sign so that Rz(a) Ry(b) z points along `vector` (3, ...)."""
    x, y, z = vector
    sine = np.hypot(x, y)
    azimuth = np.where(sine > _SINGULAR, np.arctan2(sign * y, sign * x), azimuth_if_upright)
    return azimuth, sign * np.arctan2(sine, z)


def _turn_z(vector: Floats, angle: Floats) -> Floats:
    """Rz(angle) applied to vectors (3, ...)."""
    x, y, z = vector
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack(np.broadcast_arrays(cosine * x - sine * y, sine * x + cosine * y, z))


def _turn_y(vector: Floats, angle: Floats) -> Floats:
    """Ry(angle) applied to vectors (3, ...)."""
    x, y, z = vector
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack(np.broadcast_arrays(cosine * x + sine * z, y, cosine * z - sine * x))


def _limit_error(arm: ArmModel, posture: Floats, worst: int, joint_margin: float) -> UnreachableError:
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
