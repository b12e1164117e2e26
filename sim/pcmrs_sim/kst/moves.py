"""Point-to-point motions as the cabinet plans them."""

from __future__ import annotations

import numpy as np

from pcmrs.errors import DeviceError
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.straight import straight_motion
from pcmrs.kinematics.time_parameterization import PERIOD, joint_request, sample_times, solve
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform

ACCELERATION = 3.0
"""Acceleration of each joint, rad/s^2."""
JERK = 30.0
"""Jerk of each joint, rad/s^3."""
SMALLEST_FRACTION, SLOWEST = 1e-2, 1e-3
"""Smallest fraction of the joints' speed, and slowest speed along a line, m/s. A slower motion would take hours, and a
motion is planned as a whole."""
FARTHEST = 10.0
"""Largest coordinate of a goal in the base frame, m: beyond the reach of any iiwa."""


def joint_move(arm: ArmModel, start: Floats, goal: Floats, fraction: float) -> JointTrajectory:
    """Plan a motion of all joints from rest to rest. They start and end together.

    Args:
        arm: Model of the arm.
        start: Posture at the start, rad, (n,).
        goal: Posture at the end, rad, (n,).
        fraction: Fraction of each joint's speed.

    Raises:
        DeviceError: The fraction is not in [0.01, 1].
        UnreachableError: The goal is out of the joints' ranges.
    """
    if not SMALLEST_FRACTION <= fraction <= 1.0:
        text = f"The relative joint speed is {fraction:g}, must be in [{SMALLEST_FRACTION:g}, 1]; send jRelVel first."
        raise DeviceError(text, part=fraction)
    arm.check_limits(goal)
    request = joint_request(fraction * arm.velocity, _limits(arm, 1.0))
    request.current_position, request.target_position = start.tolist(), goal.tolist()
    profile = solve(request)
    times = sample_times(profile.duration, 1.0, PERIOD)
    return JointTrajectory(period=PERIOD, positions=[profile.at_time(time)[0] for time in times.tolist()])


def straight_move(
    arm: ArmModel, start: Floats, base_from_tool: Transform, flange_from_tool: Transform, speed: float
) -> JointTrajectory:
    """Plan a motion from rest to rest with the tool frame on a straight line.

    Args:
        arm: Model of the arm.
        start: Posture at the start, rad, (n,).
        base_from_tool: Goal of the tool frame.
        flange_from_tool: The tool frame.
        speed: Speed of its origin, m/s.

    Raises:
        DeviceError: The speed is below 1 mm/s, or the goal is farther than any arm reaches.
        UnreachableError: The arm cannot follow the line.
    """
    if not speed >= SLOWEST:
        text = f"The speed is {speed:g} m/s, must be {SLOWEST:g} or more; send jRelVel in mm/s first."
        raise DeviceError(text, speed=speed)
    if not np.abs(base_from_tool.translation).max() <= FARTHEST:
        raise DeviceError(f"The goal is more than {FARTHEST:g} m from the base.", limit=FARTHEST)
    goal = base_from_tool @ flange_from_tool.inverse()
    return straight_motion(arm, start, goal, _limits(arm, speed), flange_from_tool=flange_from_tool)


def _limits(arm: ArmModel, speed: float) -> MotionLimits:
    joints = arm.joints
    return MotionLimits(
        joint_velocity=tuple(np.asarray(arm.velocity).tolist()),
        joint_acceleration=(ACCELERATION,) * joints,
        joint_jerk=(JERK,) * joints,
        linear_velocity=speed,
        linear_acceleration=0.5,
        linear_jerk=5.0,
        angular_velocity=1.0,
        angular_acceleration=2.0,
    )
