"""Inverse kinematics in closed form for arms with three parallel axes, such as those of Universal Robots.

The pose fixes the point where axes 5 and 6 meet. Its distance from the plane of the arm gives joint 1, the direction of
axis 6 gives joint 5, and the triangle of upper arm and forearm gives joint 3: two solutions each, so eight branches.
After K. P. Hawkins, Analytic Inverse Kinematics for the Universal Robots UR-5/UR-10 Arms, Georgia Institute of
Technology (2013), with the plane of the arm as complex numbers. Joints that can turn more than once may take each
branch at several positions.
"""

from __future__ import annotations

from cmath import phase, rect
from itertools import product
from math import acos, atan2, copysign, cos, hypot, pi, sin, tau

import numpy as np

from pcmrs.errors import UnreachableError
from pcmrs.kinematics._branches import FORBIDDEN, Branches, settled
from pcmrs.kinematics._geometry import UrGeometry
from pcmrs.kinematics._posture import DETOUR, SINGULAR_COMFORT, comfort_penalty, forearm_penalty
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform

REACH_TOLERANCE = 1e-9  # m beyond the workspace that rounding may produce
_SINGULAR = 1e-10  # sine of joint 5 below which axes 4 and 6 count as parallel: a URDF rounds angles to 1e-11 rad
# Each joint at its position nearest to the seed, or at the next one a whole turn away, in the 64 combinations.
_TURNS = Branches(np.arange(6) + 6 * np.array(list(product((0, 1), repeat=6))))


def solve(
    arm: ArmModel,
    geometry: UrGeometry,
    base_from_flange: Transform,
    seed: Floats,
    joint_margin: float,
    keep_away: Floats | None,
) -> Floats:
    """Return the posture of least cost, rad, (6,).

    Args:
        arm: Model of the arm.
        geometry: Geometry of the arm.
        base_from_flange: Pose of the flange to reach, in the robot's base.
        seed: Joint positions to stay close to, rad, (6,).
        joint_margin: Distance to keep from every joint limit, rad.
        keep_away: Spheres as returned by `pcmrs.kinematics._posture.sphere_array`, m, (M, 4), or None.

    Raises:
        UnreachableError: The pose is too far or too near, or no posture keeps the joint limits.
    """
    postures = np.array(_postures(arm, geometry, base_from_flange, seed)).T
    # A third position would be farther from the seed by a whole turn, which no comfort is worth.
    near = np.clip(seed, arm.lower, arm.upper)[:, None]
    first = postures - tau * np.round((postures - near) / tau)
    values = np.concatenate((first, first + np.where(first > near, -tau, tau)))
    short: Floats = comfort_penalty(geometry.singular_angles(postures), SINGULAR_COMFORT).sum(axis=0)
    if keep_away is not None:
        short += np.array([forearm_penalty(arm, posture, keep_away) for posture in postures.T])
    scores = _TURNS.scores(arm, values, seed, joint_margin, DETOUR * short)
    turns, column = divmod(int(np.argmin(scores)), scores.shape[1])
    best = _TURNS.posture(values, turns, column)
    if scores[turns, column] >= FORBIDDEN:
        return settled(arm, base_from_flange, best, joint_margin)  # rounding counts for more in a singular posture
    return best


def _postures(arm: ArmModel, geometry: UrGeometry, base_from_flange: Transform, near: Floats) -> list[list[float]]:
    """Return the joint positions of each branch that reaches the pose, in any turn, rad, up to 8 rows of 6.

    In the shoulder frame, the last link has turned by Rz(q1) Ry(q2 + q3 + q4) Rz(-q5) Ry(q6) since the zero posture. If
    axes 4 and 6 are parallel, joint 6 is free: there are branches with its position in `near` and with a straight arm.

    Raises:
        UnreachableError: The pose is too far or too near in all branches.
    """
    last = geometry.shoulder_from_last(base_from_flange)
    (forward, side, up), (x, y, z) = last.rotation.tolist(), last.translation.tolist()
    found: list[list[float]] = []
    reaches: list[float] = []
    for q1 in _pans(arm, geometry, x, y):
        c1, s1 = cos(q1), sin(q1)
        ahead = [c1 * a + s1 * b for a, b in zip(forward, side, strict=True)]
        across = [c1 * b - s1 * a for a, b in zip(forward, side, strict=True)]
        bend = atan2(hypot(across[0], across[2]), across[1])
        for q5 in (bend, -bend):
            point = complex(c1 * x + s1 * y, -z)
            if abs(s5 := sin(q5)) > _SINGULAR:
                wrists = [atan2(-across[2] / s5, -across[0] / s5)]
            else:
                wrists = _free_wrists(geometry, point, atan2(ahead[2], up[2]), across[1], float(near[5]))
            for q6 in wrists:
                c6, s6 = cos(q6), sin(q6)
                pitch = atan2(c6 * ahead[2] - s6 * ahead[0], c6 * up[2] - s6 * up[0])
                hand = point - geometry.hand * rect(1.0, pitch)
                reaches.append(abs(hand))
                found += [[q1, q2, q3, pitch - q2 - q3, q5, q6] for q2, q3 in _triangles(geometry, hand)]
    if not found:
        raise _reach_error(geometry, reaches)
    return found


def _pans(arm: ArmModel, geometry: UrGeometry, x: float, y: float) -> tuple[float, float]:
    """Return the positions of joint 1 for which the point where axes 5 and 6 meet is beside the plane of the arm, rad.

    Args:
        arm: Model of the arm.
        geometry: Geometry of the arm.
        x: Position of that point in the shoulder frame, m.
        y: Position of that point in the shoulder frame, m.

    Raises:
        UnreachableError: The point is too near to axis 1.
    """
    radius, offset = hypot(x, y), geometry.offset
    if radius < abs(offset) - REACH_TOLERANCE:
        raise UnreachableError(
            f"The pose is too near: the wrist would be {radius:.4f} m from the axis of {arm.facts.joints[0].name} and "
            f"cannot be nearer than {abs(offset):.4f} m; move it away from that axis by "
            f"{(abs(offset) - radius) * 1e3:.1f} mm.",
            reach=radius,
            limit=abs(offset),
        )
    middle, half = atan2(y, x) - pi / 2.0, acos(min(1.0, max(-1.0, offset / radius)))
    return middle + half, middle - half


def _free_wrists(geometry: UrGeometry, point: complex, turn: float, sign: float, near: float) -> list[float]:
    """Return positions of joint 6 if its axis is parallel to axis 4, rad: `near`, and those with a straight elbow.

    With `near` the pose may be out of reach, because axis 4 has to be on the other side of the wrist.

    Args:
        geometry: Geometry of the arm.
        point: Where axes 5 and 6 meet, in the plane of the arm, m.
        turn: Turn of the last link in that plane, rad.
        sign: 1 if joint 5 is at 0, or -1 if it is at half a turn.
        near: Position of joint 6 in the seed, rad.
    """
    upper_arm, forearm, hand = abs(geometry.upper_arm), abs(geometry.forearm), abs(geometry.hand)
    middle, found = phase(point / geometry.hand), [near]
    for reach in (upper_arm + forearm, abs(upper_arm - forearm)):
        cosine = (abs(point) ** 2 + hand**2 - reach**2) / max(2.0 * abs(point) * hand, _SINGULAR)
        angle = acos(min(1.0, max(-1.0, cosine)))  # if there is no such position: the nearest to it
        found += [copysign(1.0, sign) * (turn - pitch) for pitch in (middle + angle, middle - angle)]
    return found


def _triangles(geometry: UrGeometry, hand: complex) -> list[tuple[float, float]]:
    """Return the positions of joints 2 and 3 that bring axis 4 to a point in the plane of the arm, rad: two or none."""
    upper_arm, forearm = abs(geometry.upper_arm), abs(geometry.forearm)
    if not abs(upper_arm - forearm) - REACH_TOLERANCE <= abs(hand) <= upper_arm + forearm + REACH_TOLERANCE:
        return []
    cosine = (abs(hand) ** 2 - upper_arm**2 - forearm**2) / (2.0 * upper_arm * forearm)
    bend, straight = acos(min(1.0, max(-1.0, cosine))), -phase(geometry.forearm / geometry.upper_arm)
    elbows = (straight + bend, straight - bend)
    return [(phase(hand) - phase(geometry.upper_arm + geometry.forearm * rect(1.0, q3)), q3) for q3 in elbows]


def _reach_error(geometry: UrGeometry, reaches: list[float]) -> UnreachableError:
    """Return the error for distances of axis 4 from axis 2, m, that no triangle of upper arm and forearm has."""
    upper_arm, forearm = abs(geometry.upper_arm), abs(geometry.forearm)
    stretched, folded = upper_arm + forearm, abs(upper_arm - forearm)
    reach = min(reaches, key=lambda distance: max(distance - stretched, folded - distance))
    if reach > stretched:
        text = f"far: the wrist would be {reach:.4f} m from the shoulder, the stretched arm reaches {stretched:.4f} m"
        remedy, limit = f"bring it {(reach - stretched) * 1e3:.1f} mm closer", stretched
    else:
        text = f"near: the wrist would be {reach:.4f} m from the shoulder, the folded arm reaches {folded:.4f} m"
        remedy, limit = f"move it {(folded - reach) * 1e3:.1f} mm away", folded
    return UnreachableError(f"The pose is too {text}; {remedy}.", reach=reach, limit=limit)
