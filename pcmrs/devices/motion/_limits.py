"""Limits of requests: trajectories and presses that an arm refuses."""

from __future__ import annotations

import numpy as np

from pcmrs.errors import DeviceError
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.messages import JointTrajectory, PressRequest
from pcmrs.spatial import Floats

START_TOLERANCE = 0.02
"""Greatest distance of a trajectory's start from the present set posture, rad in any joint."""
PRESS_FORCE = (1.0, 5.0)
"""Range of the force of a press, N."""
PRESS_TRAVEL = 0.010
"""Longest travel of a press, m."""
PRESS_SPEED = 0.05
"""Greatest speed of a press, m/s."""
PRESS_TIMEOUT = 20.0
"""Longest duration of a press, s."""
UNIT_TOLERANCE = 1e-3
"""Greatest deviation of the length of a unit vector from 1."""
ROUNDING = 1e-6
"""Excess over a limit, relative to it, that is accepted, so that a planner may use the whole range."""


def check_trajectory(trajectory: JointTrajectory, posture: Floats, facts: ArmFacts) -> None:
    """Check shape, start, position limits and speed limits of a trajectory.

    Args:
        trajectory: Requested trajectory.
        posture: Present set posture, rad, (n,).
        facts: Data of the arm, with the limits of its joints from the data sheet.

    Raises:
        DeviceError: The trajectory must not be followed.
    """
    positions = _positions(trajectory, len(facts.joints))
    _check_start(positions[0], posture)
    _check_range(positions, facts)
    _check_speed(np.diff(positions, axis=0) / trajectory.period, facts)


def check_press(request: PressRequest) -> None:
    """Check that all values of a press are in their ranges.

    Raises:
        DeviceError: A value is out of range.
    """
    length = float(np.linalg.norm(request.direction_in_flange))
    for what, value, low, high, unit in (
        ("force", request.force, *PRESS_FORCE, "N"),
        ("travel", request.travel, 0.0, PRESS_TRAVEL, "m"),
        ("speed", request.speed, 0.0, PRESS_SPEED, "m/s"),
        ("timeout", request.timeout, 0.0, PRESS_TIMEOUT, "s"),
        ("length of the direction", length, 1 - UNIT_TOLERANCE, 1 + UNIT_TOLERANCE, ""),
    ):
        if not (low <= value <= high and value > 0.0):
            text = f"The {what} of a press is {value:g} {unit}, must be {low:g} to {high:g} {unit}; change the request."
            raise DeviceError(text, what=what, value=value, lowest=low, highest=high)


def _positions(trajectory: JointTrajectory, joints: int) -> Floats:
    if not 0.0 < trajectory.period < np.inf or not trajectory.positions:
        raise DeviceError(
            f"A trajectory needs a positive period and at least the present posture, not {trajectory.period} s and "
            f"{len(trajectory.positions)} postures; plan it again.",
            period=trajectory.period,
            postures=len(trajectory.positions),
        )
    if any(len(posture) != joints for posture in trajectory.positions):
        raise DeviceError(f"Every posture of a trajectory must have {joints} joints; send all of them.", joints=joints)
    positions = np.array(trajectory.positions, dtype=float)
    if not np.isfinite(positions).all():
        raise DeviceError("The trajectory holds a number that is not finite; nothing was moved.")
    return positions


def _check_start(start: Floats, posture: Floats) -> None:
    joint = int(np.abs(start - posture).argmax())
    distance = float(abs(start[joint] - posture[joint]))
    if distance > START_TOLERANCE:
        raise DeviceError(
            f"The trajectory starts {distance:.3f} rad from the present posture in joint {joint + 1}, limit "
            f"{START_TOLERANCE} rad; plan it again from the present joints.",
            joint=joint + 1,
            distance=distance,
            limit=START_TOLERANCE,
        )


def _check_range(positions: Floats, facts: ArmFacts) -> None:
    lower = np.array([joint.lower for joint in facts.joints])
    upper = np.array([joint.upper for joint in facts.joints])
    excess = np.maximum(lower - positions, positions - upper).max(axis=0)
    joint = int(excess.argmax())
    if excess[joint] > ROUNDING:
        raise DeviceError(
            f"The trajectory leaves the range [{lower[joint]:.4f}, {upper[joint]:.4f}] rad of joint {joint + 1} by "
            f"{excess[joint]:.4f} rad; plan within the limits.",
            joint=joint + 1,
            excess=float(excess[joint]),
            lower=float(lower[joint]),
            upper=float(upper[joint]),
        )


def _check_speed(velocities: Floats, facts: ArmFacts) -> None:
    limits = np.array([joint.velocity for joint in facts.joints])
    fastest = np.abs(velocities).max(axis=0, initial=0.0)
    joint = int((fastest / limits).argmax())
    if fastest[joint] > limits[joint] * (1 + ROUNDING):
        raise DeviceError(
            f"The trajectory moves joint {joint + 1} at {fastest[joint]:.3f} rad/s, limit {limits[joint]:.3f} rad/s; "
            "plan it slower.",
            joint=joint + 1,
            velocity=float(fastest[joint]),
            limit=float(limits[joint]),
        )
