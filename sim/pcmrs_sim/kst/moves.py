"""Motions and postures as the cabinet plans them."""

from __future__ import annotations

from math import ceil

import numpy as np
from ruckig import InputParameter

from pcmrs.errors import DeviceError
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.straight import straight_motion
from pcmrs.kinematics.time_parameterization import PERIOD, CubicSpline, joint_request, sample_times, solve
from pcmrs.kinematics.track import track
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

_KNOT_DISTANCE, _KNOT_ANGLE = 0.002, 0.005
"""Distance, m, and angle, rad, between the postures that describe an arc."""
_LEAST_AREA = 1e-8
"""Area of the parallelogram of three places below which they count as on a line, m^2."""


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
    _check_speed(speed)
    _check_near(base_from_tool)
    goal = base_from_tool @ flange_from_tool.inverse()
    return straight_motion(arm, start, goal, _limits(arm, speed), flange_from_tool=flange_from_tool)


def circular_move(
    arm: ArmModel,
    start: Floats,
    base_from_middle: Transform,
    base_from_end: Transform,
    flange_from_tool: Transform,
    speed: float,
) -> JointTrajectory:
    """Plan a motion from rest to rest with the tool frame on an arc, turning evenly from its first to its last pose.

    Args:
        arm: Model of the arm.
        start: Posture at the start, rad, (n,).
        base_from_middle: Pose of the tool frame on the way, of which only the place is used.
        base_from_end: Pose of the tool frame at the end.
        flange_from_tool: The tool frame.
        speed: Greatest speed of its origin, m/s. It is slower where a joint would be too fast.

    Raises:
        DeviceError: The speed is below 1 mm/s, a pose is farther than any arm reaches, the three places lie on a line,
            or the arc is too long.
        UnreachableError: The arm cannot follow the arc.
    """
    _check_speed(speed)
    _check_near(base_from_middle)
    _check_near(base_from_end)
    arc = _Arc(arm.forward(start) @ flange_from_tool, base_from_middle.translation, base_from_end)
    tool_from_flange = flange_from_tool.inverse()
    knots = np.linspace(0.0, 1.0, 1 + max(8, ceil(arc.length / _KNOT_DISTANCE), ceil(arc.turn / _KNOT_ANGLE)))
    postures = [start]
    for knot in knots[1:].tolist():
        postures.append(track(arm, arc.base_from_tool(knot) @ tool_from_flange, postures[-1]))
    along = CubicSpline(knots, np.array(postures))
    limits = _limits(arm, speed)
    fastest = float((np.abs(along(knots, order=1)) / np.array(limits.joint_velocity)).max())
    velocity = 1.0 / max(arc.length / speed, arc.turn / limits.angular_velocity, fastest)
    request = InputParameter(1)
    request.target_position, request.max_velocity = [1.0], [velocity]
    request.max_acceleration = [limits.linear_acceleration / arc.length]
    request.max_jerk = [limits.linear_jerk / arc.length]
    profile = solve(request)
    times = sample_times(profile.duration, 1.0, PERIOD).tolist()
    progress = np.clip([profile.at_time(time)[0][0] for time in times], 0.0, 1.0)
    return JointTrajectory(period=PERIOD, positions=along(progress).tolist())


def servo_posture(arm: ArmModel, base_from_tool: Transform, flange_from_tool: Transform, seed: Floats) -> Floats:
    """Return the posture for a set point of the tool frame, rad, (n,).

    Args:
        arm: Model of the arm.
        base_from_tool: The set point.
        flange_from_tool: The tool frame.
        seed: Posture of the set point before, rad, (n,).

    Raises:
        DeviceError: The set point is farther than any arm reaches.
        UnreachableError: The arm cannot follow.
    """
    _check_near(base_from_tool)
    return track(arm, base_from_tool @ flange_from_tool.inverse(), seed)


class _Arc:
    """The arc of a tool frame over a parameter from 0 to 1.

    Args:
        start: Pose at the start, in the base.
        middle: Place on the way, in the base, m, (3,).
        end: Pose at the end, in the base.

    Attributes:
        length: Length of the arc, m.
        turn: Angle between the poses at start and end, rad.

    Raises:
        DeviceError: The three places lie on a line, or the arc is longer than any arm reaches.
    """

    def __init__(self, start: Transform, middle: Floats, end: Transform) -> None:
        first, second = middle - start.translation, end.translation - start.translation
        normal = np.cross(first, second)
        area = float(np.linalg.norm(normal))
        if area < _LEAST_AREA:
            raise DeviceError("The places of the circle lie on a line; choose another place on the way.", area=area)
        # The centre of the circle through three places, relative to the first one.
        centre = (np.cross(normal, first) * (second @ second) + np.cross(second, normal) * (first @ first)) / (
            2.0 * area**2
        )
        self._centre = start.translation + centre
        self._axis_x, self._axis_y = -centre, np.cross(normal / area, -centre)
        to_end = end.translation - self._centre
        self._angle = float(np.arctan2(to_end @ self._axis_y, to_end @ self._axis_x) % (2.0 * np.pi))
        self._start_rotation = start.rotation
        self._rotvec = Transform(start.rotation.T @ end.rotation, np.zeros(3)).rotvec
        self.length = self._angle * float(np.linalg.norm(centre))
        if self.length > FARTHEST:
            raise DeviceError(f"The arc is {self.length:.0f} m long, must be at most {FARTHEST:g} m.", limit=FARTHEST)
        self.turn = float(np.linalg.norm(self._rotvec))

    def base_from_tool(self, parameter: float) -> Transform:
        """Return the pose of the tool frame at a parameter from 0 to 1."""
        angle = parameter * self._angle
        place = self._centre + np.cos(angle) * self._axis_x + np.sin(angle) * self._axis_y
        turned = Transform.from_rotvec(np.zeros(3), parameter * self._rotvec).rotation
        return Transform(self._start_rotation @ turned, place)


def _check_speed(speed: float) -> None:
    if not speed >= SLOWEST:
        text = f"The speed is {speed:g} m/s, must be {SLOWEST:g} or more; send jRelVel in mm/s first."
        raise DeviceError(text, speed=speed)


def _check_near(base_from_tool: Transform) -> None:
    if not np.abs(base_from_tool.translation).max() <= FARTHEST:
        raise DeviceError(f"The goal is more than {FARTHEST:g} m from the base.", limit=FARTHEST)


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
