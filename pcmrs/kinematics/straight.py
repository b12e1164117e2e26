"""Motion of the tool along a straight line."""

from __future__ import annotations

from math import ceil

import numpy as np
import numpy.typing as npt
from ruckig import InputParameter, Trajectory
from scipy.interpolate import CubicSpline

from pcmrs.errors import UnreachableError
from pcmrs.kinematics.joints import joint_array
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.profile import PERIOD, sample_times, solve
from pcmrs.kinematics.track import track
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform

_NO_WAY = 1e-12  # s; a motion that would take less is none
_KNOT_DISTANCE = 0.002  # m
_KNOT_ANGLE = 0.005  # rad
_FEWEST_KNOTS = 5
_RESERVE = 1.01  # on a stretched motion, whose samples fall on other points of the line


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
        GeometryError: `start_q` does not hold seven finite numbers.
        UnreachableError: The arm cannot follow the line to its end; the text says how far it can.
    """
    tool = flange_from_tool or Transform.identity()
    line = _Line(arm.forward(start_q) @ tool, base_from_flange_goal @ tool, tool)
    request = line.request(limits)
    if request is None:
        return JointTrajectory(period=period, positions=[joint_array(start_q).tolist()])
    profile = solve(request)
    along = _postures_along(arm, start_q, line)
    postures = _sampled(along, profile, sample_times(profile.duration, 1.0, period))
    stretch = _overload(postures, period, arm, limits)
    if stretch > 1.0:
        postures = _sampled(along, profile, sample_times(profile.duration, _RESERVE * stretch, period))
    return JointTrajectory(period=period, positions=postures.tolist())


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

    def knots(self) -> int:
        """How many postures describe the line: so many that a cubic between them leaves it by under a nanometre."""
        length, angle = float(np.linalg.norm(self._way)), float(np.linalg.norm(self._turn))
        return max(_FEWEST_KNOTS, 1 + ceil(max(length / _KNOT_DISTANCE, angle / _KNOT_ANGLE)))

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


def _postures_along(arm: ArmModel, start_q: npt.ArrayLike, line: _Line) -> CubicSpline:
    """Joint positions over the parameter of the line, (7,): exact at knots `_KNOT_DISTANCE` or `_KNOT_ANGLE` apart."""
    knots = np.linspace(0.0, 1.0, line.knots())
    postures = [joint_array(start_q)]
    for parameter in knots[1:]:
        try:
            postures.append(track(arm, line.base_from_flange(parameter), postures[-1]))
        except UnreachableError as error:
            text = f"The straight line can be followed for {100.0 * parameter:.0f} % of its way only. {error.text}"
            raise UnreachableError(text, parameter=float(parameter), **error.fields) from error
    return CubicSpline(knots, np.array(postures))


def _sampled(along: CubicSpline, profile: Trajectory, times: Floats) -> Floats:
    """Joint positions at the profile's times, (N, 7)."""
    return np.asarray(along([profile.at_time(time)[0][0] for time in times]))


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
