"""Joint trajectories with bounded jerk: point to point, along a straight line, and to a stop.

All of them keep their path whatever the limits are. The limits only set how fast the path is followed.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
import numpy.typing as npt
from ruckig import ControlInterface, Synchronization

from pcmrs.errors import GeometryError
from pcmrs.kinematics.limits import MotionLimits, joint_array
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.straight import straight_motion
from pcmrs.kinematics.time_parameterization import (
    PERIOD,
    ProgressLimits,
    SpeedLimitAt,
    joint_request,
    sample_times,
    solve,
    speed_limits_at,
    time_parameterize,
    tool_path_lengths,
)
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform

__all__ = ["MotionLimits", "brake", "concatenate", "joint_motion", "straight_motion"]

JOIN_TOLERANCE = 1e-6  # rad between the end of one trajectory and the start of the next

_NO_PART = 1e-12  # share of the motion of the joint that moves farthest; a joint that moves less sets no limit
_PLACE_DISTANCE = 0.006  # rad in any joint between two places at which the speed limit is evaluated


def joint_motion(
    arm: ArmModel,
    start: npt.ArrayLike,
    goal: npt.ArrayLike,
    limits: MotionLimits,
    period: float = PERIOD,
    *,
    flange_from_tool: Transform | None = None,
    speed_limit_at: SpeedLimitAt | None = None,
) -> JointTrajectory:
    """Move all joints together from rest to rest on a straight line of joint space.

    Args:
        arm: Model of the arm.
        start: Joint positions at the start, rad, (n,).
        goal: Joint positions at the end, rad, (n,).
        limits: Limits of the joints, and `linear_velocity` of flange and tool point whatever their paths are.
        period: Time between samples, s.
        flange_from_tool: Pose of the tool point in the flange; the flange itself by default.
        speed_limit_at: Lower speed limits of flange and tool point at some postures.

    Raises:
        GeometryError: `start` or `goal` does not hold one finite number per joint.
        UnreachableError: `goal` breaks a joint limit.
    """
    arm.check_limits(goal)
    begin, end = joint_array(start, arm.joints), joint_array(goal, arm.joints)
    farthest = float(np.abs(end - begin).max())
    if farthest <= JOIN_TOLERANCE:  # already there
        return JointTrajectory(period=period, positions=[begin.tolist()])
    places = np.linspace(0.0, 1.0, 1 + ceil(farthest / _PLACE_DISTANCE))
    postures = begin + places[:, None] * (end - begin)
    path_lengths = tool_path_lengths(arm, postures, flange_from_tool or Transform.identity())
    speeds = speed_limits_at(postures, limits, speed_limit_at)
    progress = time_parameterize(places, path_lengths, speeds, _joint_bounds(arm, np.abs(end - begin), limits))
    parts = progress.at(sample_times(progress.duration, 1.0, period))
    positions = begin + parts[:, None] * (end - begin)
    # Exactly, without the rounding of the progress.
    positions[-1] = end
    return JointTrajectory(period=period, positions=positions.tolist())


def _joint_bounds(arm: ArmModel, travel: Floats, limits: MotionLimits) -> ProgressLimits:
    """Return the limits of the progress along a straight way in joint space, rad, (n,), set by the joints."""
    velocity = np.minimum(limits.joint_velocity, arm.velocity)
    values = np.array((velocity, limits.joint_acceleration, limits.joint_jerk))
    moving = travel > _NO_PART * travel.max()
    return ProgressLimits(*(values[:, moving] / travel[moving]).min(axis=1).tolist())


def concatenate(a: JointTrajectory, b: JointTrajectory) -> JointTrajectory:
    """Join two trajectories. The posture between them, where the arm rests, appears once.

    Args:
        a: First trajectory.
        b: Second trajectory, which starts where `a` ends.

    Raises:
        GeometryError: Their periods differ, or `b` does not start where `a` ends.
    """
    gap = float(np.abs(np.subtract(a.positions[-1], b.positions[0])).max())
    if a.period != b.period or gap > JOIN_TOLERANCE:
        raise GeometryError(
            f"Trajectories join only with equal periods ({a.period:g} s, {b.period:g} s) and where the second starts "
            f"at the end of the first (gap {gap:.3g} rad, limit {JOIN_TOLERANCE:g} rad); plan the second again.",
            periods=[a.period, b.period],
            gap=gap,
        )
    stops = [*a.stops, *(len(a.positions) - 1 + stop for stop in b.stops)]
    return JointTrajectory(period=a.period, positions=a.positions + b.positions[1:], stops=stops)


def brake(
    positions: Sequence[float], velocities: Sequence[float], limits: MotionLimits, period: float = PERIOD
) -> JointTrajectory:
    """Stop every joint as fast as its acceleration and jerk limits allow.

    Args:
        positions: Joint positions now, rad, (n,).
        velocities: Joint velocities now, rad/s, (n,).
        limits: Limits of the joints. Joint positions are not limited, because nothing may keep the arm from braking.
        period: Time between samples, s.

    Raises:
        GeometryError: `positions` or `velocities` are not one finite number per joint.
    """
    joints = len(limits.joint_velocity)
    velocity = joint_array(velocities, joints)
    # An arm that is faster than its limit must be braked, too.
    request = joint_request(np.maximum(limits.joint_velocity, np.abs(velocity)), limits)
    # A target velocity without a target position, and each joint on its own: nothing delays the stop.
    request.control_interface = ControlInterface.Velocity
    request.synchronization = Synchronization.No
    request.current_position = joint_array(positions, joints).tolist()
    request.current_velocity = velocity.tolist()
    profile = solve(request)
    count = ceil(profile.duration / period)
    return JointTrajectory(period=period, positions=[profile.at_time(k * period)[0] for k in range(count + 1)])
