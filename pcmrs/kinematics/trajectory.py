"""Joint trajectories with bounded jerk: point to point, along a straight line, and to a stop.

Ruckig computes the profiles (L. Berscheid, T. Kröger, Jerk-limited Real-time Trajectory Generation with Arbitrary
Target States, RSS 2021). Where another limit would be exceeded, the whole motion is stretched in time, which
keeps its path and can only lower its derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np
import numpy.typing as npt
from ruckig import ControlInterface, InputParameter, Result, Ruckig, Synchronization, Trajectory

from pcmrs.errors import GeometryError, UnreachableError
from pcmrs.kinematics.limits import JOINTS, MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.track import track
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform

__all__ = ["MotionLimits", "brake", "concatenate", "joint_motion", "straight_motion"]

PERIOD = 0.005  # s between the samples of a trajectory
JOIN_TOLERANCE = 1e-6  # rad between the end of one trajectory and the start of the next
_NO_WAY = 1e-12  # s; a motion that would take less is none


def joint_motion(
    arm: ArmModel, start: npt.ArrayLike, goal: npt.ArrayLike, limits: MotionLimits, period: float = PERIOD
) -> JointTrajectory:
    """Moves all joints together from rest at `start` to rest at `goal`, rad, (7,).

    The flange moves at `limits.linear_velocity` at most, whatever its path.

    Raises:
        UnreachableError: `goal` breaks a joint limit.
    """
    arm.check_limits(goal)
    request = _request(JOINTS, np.minimum(limits.joint_velocity, arm.velocity), limits)
    request.current_position, request.target_position = list(np.asarray(start)), list(np.asarray(goal))
    profile = _solve(request)
    states = [profile.at_time(time) for time in _times(profile.duration, 1.0, period)]
    speed = max(float(np.linalg.norm((arm.jacobian(q) @ velocity)[:3])) for q, velocity, _ in states)
    stretch = max(1.0, speed / limits.linear_velocity)
    positions = [profile.at_time(time)[0] for time in _times(profile.duration, stretch, period)]
    positions[0], positions[-1] = request.current_position, request.target_position
    return JointTrajectory(period=period, positions=positions)


def straight_motion(
    arm: ArmModel,
    start_q: npt.ArrayLike,
    base_from_flange_goal: Transform,
    limits: MotionLimits,
    period: float = PERIOD,
    *,
    flange_from_tool: Transform | None = None,
) -> JointTrajectory:
    """Moves the tool point from rest on a straight line, turning it about a fixed axis, to rest.

    Args:
        arm: The arm.
        start_q: Joint positions at the start, rad, (7,).
        base_from_flange_goal: Pose of the flange at the end.
        limits: Of the tool and of the joints; angular jerk is bounded so that angular acceleration takes as
            long to build up as linear acceleration.
        period: Time between samples, s.
        flange_from_tool: Pose of the tool point; the flange itself by default.

    Raises:
        UnreachableError: The arm cannot follow the line to its end; the text says how far it can.
    """
    tool = flange_from_tool or Transform.identity()
    line = _Line(arm.forward(start_q) @ tool, base_from_flange_goal @ tool, tool)
    request = line.request(limits)
    if request is None:
        return JointTrajectory(period=period, positions=[np.asarray(start_q, dtype=float).tolist()])
    profile = _solve(request)
    postures = _follow(arm, start_q, line, profile, _times(profile.duration, 1.0, period))
    stretch = _overload(postures, period, arm, limits)
    if stretch > 1.0:
        postures = _follow(arm, start_q, line, profile, _times(profile.duration, stretch, period))
    return JointTrajectory(period=period, positions=postures.tolist())


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
    """
    request = _request(JOINTS, np.maximum(limits.joint_velocity, np.abs(velocities)), limits)
    request.control_interface = ControlInterface.Velocity
    request.synchronization = Synchronization.No
    request.current_position, request.current_velocity = list(positions), list(velocities)
    profile = _solve(request)
    count = ceil(profile.duration / period)
    return JointTrajectory(period=period, positions=[profile.at_time(k * period)[0] for k in range(count + 1)])


class _Line:
    """The straight way of a tool pose, by a parameter from 0 to 1."""

    def __init__(self, start: Transform, goal: Transform, flange_from_tool: Transform) -> None:
        self._start = start
        self._way = goal.translation - start.translation
        self._turn = Transform(start.rotation.T @ goal.rotation, np.zeros(3)).rotvec
        self._tool_from_flange = flange_from_tool.inverse()

    def base_from_flange(self, parameter: float) -> Transform:
        tool = self._start @ Transform.from_rotvec(np.zeros(3), parameter * self._turn)
        return Transform(tool.rotation, tool.translation + parameter * self._way) @ self._tool_from_flange

    def request(self, limits: MotionLimits) -> InputParameter | None:
        """The motion of the parameter that keeps the limits of the tool; None where there is no way to go."""
        length, angle = float(np.linalg.norm(self._way)), float(np.linalg.norm(self._turn))
        angular_jerk = limits.linear_jerk / limits.linear_acceleration * limits.angular_acceleration
        shortest_time = max(length / limits.linear_velocity, angle / limits.angular_velocity)
        if shortest_time < _NO_WAY:
            return None
        request = InputParameter(1)
        request.target_position = [1.0]
        request.max_velocity = [1.0 / shortest_time]
        slowest = max(length / limits.linear_acceleration, angle / limits.angular_acceleration)
        request.max_acceleration = [1.0 / slowest]
        request.max_jerk = [1.0 / max(length / limits.linear_jerk, angle / angular_jerk)]
        return request


def _follow(arm: ArmModel, start_q: npt.ArrayLike, line: _Line, profile: Trajectory, times: Floats) -> Floats:
    """Joint positions along the line at the profile's times, (N, 7)."""
    postures = [np.asarray(start_q, dtype=float)]
    for time in times[1:]:
        parameter = profile.at_time(time)[0][0]
        try:
            postures.append(track(arm, line.base_from_flange(parameter), postures[-1]))
        except UnreachableError as error:
            text = f"The straight line can be followed for {100.0 * parameter:.0f} % of its way only. {error.text}"
            raise UnreachableError(text, parameter=parameter, **error.fields) from error
    return np.array(postures)


def _overload(postures: Floats, period: float, arm: ArmModel, limits: MotionLimits) -> float:
    """The factor in time that brings speed, acceleration and jerk of every joint within its limits, at least 1.

    Stretching time by s divides the n-th derivative by s^n.
    """
    bounds = (np.minimum(limits.joint_velocity, arm.velocity), limits.joint_acceleration, limits.joint_jerk)
    at_rest = np.pad(postures, ((3, 3), (0, 0)), mode="edge")
    factors = [
        (np.abs(np.diff(at_rest, order, axis=0)).max(axis=0) / period**order / bound).max() ** (1.0 / order)
        for order, bound in enumerate(bounds, start=1)
    ]
    return float(max(1.0, *factors))


def _request(joints: int, velocity: Floats, limits: MotionLimits) -> InputParameter:
    request = InputParameter(joints)
    request.synchronization = Synchronization.Phase
    request.max_velocity = velocity.tolist()
    request.max_acceleration = list(limits.joint_acceleration)
    request.max_jerk = list(limits.joint_jerk)
    return request


def _solve(request: InputParameter) -> Trajectory:
    """The fastest profile.

    Raises:
        GeometryError: There is none, as with numbers that are not finite.
    """
    profile = Trajectory(request.degrees_of_freedom)
    outcome = Ruckig(request.degrees_of_freedom).calculate(request, profile)
    if outcome not in (Result.Working, Result.Finished):
        raise GeometryError(f"No motion profile exists ({outcome.name}); check positions and velocities.")
    return profile


def _times(duration: float, stretch: float, period: float) -> Floats:
    """Times of a profile at which to sample it so that one sample per period plays it `stretch` times slower."""
    return np.linspace(0.0, duration, max(1, ceil(duration * stretch / period)) + 1)
