"""Joint trajectories with bounded jerk: point to point, along a straight line, and to a stop.

Where another limit would be exceeded, the whole motion is stretched in time, which keeps its path and can only
lower its derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
import numpy.typing as npt
from ruckig import ControlInterface, Synchronization, Trajectory

from pcmrs.errors import GeometryError
from pcmrs.kinematics.joints import joint_array
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.profile import PERIOD, joint_request, sample_times, solve
from pcmrs.kinematics.straight import straight_motion
from pcmrs.messages import JointTrajectory

__all__ = ["MotionLimits", "brake", "concatenate", "joint_motion", "straight_motion"]

JOIN_TOLERANCE = 1e-6  # rad between the end of one trajectory and the start of the next


def joint_motion(
    arm: ArmModel, start: npt.ArrayLike, goal: npt.ArrayLike, limits: MotionLimits, period: float = PERIOD
) -> JointTrajectory:
    """Moves all joints together from rest at `start` to rest at `goal`, rad, (7,).

    The flange moves at `limits.linear_velocity` at most, whatever its path.

    Raises:
        GeometryError: `start` or `goal` does not hold seven finite numbers.
        UnreachableError: `goal` breaks a joint limit.
    """
    arm.check_limits(goal)
    request = joint_request(np.minimum(limits.joint_velocity, arm.velocity), limits)
    request.current_position = joint_array(start).tolist()
    request.target_position = joint_array(goal).tolist()
    profile = solve(request)
    # Lower speed limits first: they keep the acceleration, which stretching alone would lower too.
    excess = _flange_speed(arm, profile, period) / limits.linear_velocity
    request.max_velocity = [velocity / max(1.0, excess) for velocity in request.max_velocity]
    profile = solve(request)
    stretch = max(1.0, _flange_speed(arm, profile, period) / limits.linear_velocity)
    positions = [profile.at_time(time)[0] for time in sample_times(profile.duration, stretch, period)]
    positions[0], positions[-1] = request.current_position, request.target_position
    return JointTrajectory(period=period, positions=positions)


def concatenate(a: JointTrajectory, b: JointTrajectory) -> JointTrajectory:
    """One trajectory after the other; the posture between them, where the arm rests, is taken once.

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
    return JointTrajectory(period=a.period, positions=a.positions + b.positions[1:])


def brake(
    positions: Sequence[float], velocities: Sequence[float], limits: MotionLimits, period: float = PERIOD
) -> JointTrajectory:
    """Stops every joint as fast as its acceleration and jerk limits allow.

    Args:
        positions: Joint positions now, rad, (7,).
        velocities: Joint velocities now, rad/s, (7,).
        limits: Of the joints; joint positions are not limited, for nothing may keep the arm from braking.
        period: Time between samples, s.

    Raises:
        GeometryError: `positions` or `velocities` are not seven finite numbers.
    """
    velocity = joint_array(velocities)
    request = joint_request(np.maximum(limits.joint_velocity, np.abs(velocity)), limits)
    request.control_interface = ControlInterface.Velocity
    request.synchronization = Synchronization.No
    request.current_position = joint_array(positions).tolist()
    request.current_velocity = velocity.tolist()
    profile = solve(request)
    count = ceil(profile.duration / period)
    return JointTrajectory(period=period, positions=[profile.at_time(k * period)[0] for k in range(count + 1)])


def _flange_speed(arm: ArmModel, profile: Trajectory, period: float) -> float:
    """The greatest speed of the flange's origin during a profile of the joints, m/s."""
    states = [profile.at_time(time) for time in sample_times(profile.duration, 1.0, period)]
    return max(float(np.linalg.norm((arm.jacobian(q) @ velocity)[:3])) for q, velocity, _ in states)
