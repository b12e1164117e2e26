"""Motion of the tool along a straight line."""

from __future__ import annotations

from math import ceil

import numpy as np
import numpy.typing as npt

from pcmrs.errors import UnreachableError
from pcmrs.kinematics.limits import MotionLimits, joint_array
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.time_parameterization import (
    PERIOD,
    CubicSpline,
    ProgressLimits,
    SpeedLimitAt,
    sample_times,
    speed_limits_at,
    time_parameterize,
    tool_path_lengths,
)
from pcmrs.kinematics.track import track
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform

_NO_MOTION = 1e-12  # s; a shorter motion counts as none
_KNOT_DISTANCE = 0.002  # m
_KNOT_ANGLE = 0.005  # rad
_FEWEST_KNOTS = 5
_SAMPLES_PER_KNOT = 8
_ROUNDING = 1e-9  # rad
_RESERVE = 1.01  # factor on every stretching of time, so that few are needed


def straight_motion(
    arm: ArmModel,
    start_q: npt.ArrayLike,
    base_from_flange_goal: Transform,
    limits: MotionLimits,
    period: float = PERIOD,
    *,
    flange_from_tool: Transform | None = None,
    speed_limit_at: SpeedLimitAt | None = None,
) -> JointTrajectory:
    """Move the tool point from rest to rest on a straight line while it turns about a fixed axis.

    Args:
        arm: Model of the arm.
        start_q: Joint positions at the start, rad, (n,).
        base_from_flange_goal: Pose of the flange at the end, in the robot's base.
        limits: Limits of the tool and of the joints. Angular jerk is bounded so that angular acceleration takes as
            long to build up as linear acceleration.
        period: Time between samples, s.
        flange_from_tool: Pose of the tool point in the flange; the flange itself by default.
        speed_limit_at: Lower speed limits of flange and tool point at some postures.

    Raises:
        GeometryError: `start_q` does not hold one finite number per joint.
        UnreachableError: The arm cannot follow the line to its end. The text says how far it can.
    """
    tool = flange_from_tool or Transform.identity()
    line = _Line(arm.forward(start_q) @ tool, base_from_flange_goal @ tool, tool)
    bounds = line.bounds(limits)
    if bounds is None:
        return JointTrajectory(period=period, positions=[joint_array(start_q, arm.joints).tolist()])
    along = _postures_along(arm, start_q, line)
    at_knots = along(along.places)
    progress = time_parameterize(
        along.places, tool_path_lengths(arm, at_knots, tool), speed_limits_at(at_knots, limits, speed_limit_at), bounds
    )
    stretch = 1.0
    while True:  # a stretched motion is sampled at other points of the line, where a joint may be quicker
        postures = along(progress.at(sample_times(progress.duration, stretch, period)))
        overload = _overload(postures, period, arm, limits)
        if overload == 1.0:
            return JointTrajectory(period=period, positions=postures.tolist())
        stretch *= _RESERVE * overload


class _Line:
    """The straight path of a tool pose over a parameter from 0 to 1."""

    def __init__(self, start: Transform, goal: Transform, flange_from_tool: Transform) -> None:
        self._start = start
        self._translation = goal.translation - start.translation
        self._turn = Transform(start.rotation.T @ goal.rotation, np.zeros(3)).rotvec
        self._tool_from_flange = flange_from_tool.inverse()

    def base_from_flange(self, parameter: float) -> Transform:
        """Return the pose of the flange in the robot's base at a parameter from 0 to 1."""
        tool = self._start @ Transform.from_rotvec(np.zeros(3), parameter * self._turn)
        return Transform(tool.rotation, tool.translation + parameter * self._translation) @ self._tool_from_flange

    def knots(self) -> int:
        """Return the number of postures that describe the line.

        There are so many that a cubic between them deviates from the line by less than a nanometre.
        """
        length, angle = float(np.linalg.norm(self._translation)), float(np.linalg.norm(self._turn))
        return max(_FEWEST_KNOTS, 1 + ceil(max(length / _KNOT_DISTANCE, angle / _KNOT_ANGLE)))

    def bounds(self, limits: MotionLimits) -> ProgressLimits | None:
        """Return the limits of the parameter that follow from those of the tool; None if there is no motion."""
        length, angle = float(np.linalg.norm(self._translation)), float(np.linalg.norm(self._turn))
        angular_jerk = limits.linear_jerk / limits.linear_acceleration * limits.angular_acceleration
        shortest_time = max(length / limits.linear_velocity, angle / limits.angular_velocity)
        if shortest_time < _NO_MOTION:
            return None
        slowest = max(length / limits.linear_acceleration, angle / limits.angular_acceleration)
        gentlest = max(length / limits.linear_jerk, angle / angular_jerk)
        return ProgressLimits(1.0 / shortest_time, 1.0 / slowest, 1.0 / gentlest)


def _postures_along(arm: ArmModel, start_q: npt.ArrayLike, line: _Line) -> CubicSpline:
    """Return the joint positions over the parameter, (n,); exact at knots `_KNOT_DISTANCE` or `_KNOT_ANGLE` apart."""
    knots = np.linspace(0.0, 1.0, line.knots())
    postures = [joint_array(start_q, arm.joints)]
    for parameter in knots[1:]:
        try:
            postures.append(track(arm, line.base_from_flange(parameter), postures[-1]))
        except UnreachableError as error:
            text = f"The straight line can be followed for {100.0 * parameter:.0f} % of its way only. {error.text}"
            raise UnreachableError(text, parameter=float(parameter), **error.fields) from error
    along = CubicSpline(knots, np.array(postures))
    _check_between_knots(arm, along)
    return along


def _check_between_knots(arm: ArmModel, along: CubicSpline) -> None:
    """Raise an error if a joint that comes to rest at its limit would swing beyond it between two knots."""
    parameters = np.linspace(0.0, 1.0, 1 + _SAMPLES_PER_KNOT * (len(along.places) - 1))
    postures = along(parameters)
    # Measured joints may start slightly beyond their limits. They must not go farther.
    excess = np.maximum(np.minimum(arm.lower, postures[0]) - postures, postures - np.maximum(arm.upper, postures[0]))
    beyond = np.flatnonzero((excess > _ROUNDING).any(axis=1))
    if len(beyond):
        parameter, joint = float(parameters[beyond[0]]), arm.facts.joints[int(np.argmax(excess[beyond[0]]))]
        text = (
            f"The straight line can be followed for {100.0 * parameter:.0f} % of its way only: {joint.name} would "
            f"leave its limits {np.degrees(joint.lower):.0f} to {np.degrees(joint.upper):.0f} deg; choose another "
            "posture to start from or another pose."
        )
        raise UnreachableError(text, parameter=parameter, joint=joint.name, lower=joint.lower, upper=joint.upper)


def _overload(postures: Floats, period: float, arm: ArmModel, limits: MotionLimits) -> float:
    """Return the factor in time that brings speed, acceleration and jerk of every joint within its limits, at least 1.

    Stretching time by s divides the n-th derivative by s^n.
    """
    bounds = (np.minimum(limits.joint_velocity, arm.velocity), limits.joint_acceleration, limits.joint_jerk)
    at_rest = np.pad(postures, ((3, 3), (0, 0)), mode="edge")
    factors = [
        (np.abs(np.diff(at_rest, order, axis=0)).max(axis=0) / period**order / bound).max() ** (1.0 / order)
        for order, bound in enumerate(bounds, start=1)
    ]
    return float(max(1.0, *factors))
