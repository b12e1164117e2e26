"""Follower of motions in segments: each is moved to its end, and after a hold there is no next one."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import pairwise
from typing import NoReturn

import numpy as np

from pcmrs.devices.motion._limits import check_trajectory
from pcmrs.devices.motion.follower import Follower
from pcmrs.devices.motion.reference import Reference
from pcmrs.errors import DeviceError
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.segments import COARSE, FINE, LONGEST, SegmentLimits
from pcmrs.messages import DeviceEvent, JointTrajectory, PressRequest
from pcmrs.spatial import Floats, rotation_angle

ROUNDING = 1e-6
"""Excess over a limit, relative to it, that is accepted, so that a planner may use the whole range."""

FIRST = SegmentLimits(COARSE.distance + FINE.distance, COARSE.angle + FINE.angle)
"""Greatest size of the first segment. It begins where the arm is, which deviates a little from the planned start."""

LEAST_SPEED = 0.01
"""Least part of the joints' speed limits with which a controller moves a segment."""


@dataclass(frozen=True, slots=True)
class MotionSegment:
    """A point-to-point motion of all joints.

    Attributes:
        goal: Posture at its end, rad, (n,).
        speed: Greatest part of any joint's speed limit that it uses.
        duration: Planned duration, s.
    """

    goal: Floats
    speed: float
    duration: float


class SegmentPath:
    """Segments that are still to be moved; its set point is the end of the last one that was taken.

    Args:
        posture: Posture at the start, rad, (n,).
        segments: Segments in their order.
    """

    halt: str | None = None
    alarm: DeviceEvent | None = None

    def __init__(self, posture: Floats, segments: list[MotionSegment]) -> None:
        self.position = posture
        self.velocity = np.zeros_like(posture)
        self._segments = deque(segments)

    @property
    def ended(self) -> bool:
        """True if the last segment was taken."""
        return not self._segments

    @property
    def next(self) -> MotionSegment | None:
        """MotionSegment to move next; None if there is none."""
        return self._segments[0] if self._segments else None

    def take(self) -> MotionSegment:
        """Take the next segment, which is moved from now on."""
        segment = self._segments.popleft()
        self.position = segment.goal
        return segment

    def advance(self) -> Floats:
        """Return the set point at rest: position, velocity and acceleration, (3, n)."""
        return np.stack((self.position, self.velocity, self.velocity))


class SegmentFollower(Follower):
    """Source of the segments of a motion. It cannot brake: a hold means that no segment follows the present one."""

    def follow(self, trajectory: JointTrajectory) -> None:
        """Move along a trajectory from now on.

        Raises:
            DeviceError: The trajectory does not start at the present posture, leaves the limits of the arm, or is not
                in segments that are short enough.
        """
        check_trajectory(trajectory, self.reference.position, self._model.facts)
        segments = _segments(trajectory, self.reference.position, self._model)
        self._begin(SegmentPath(self.reference.position, segments))

    def press(self, request: PressRequest) -> NoReturn:  # noqa: ARG002 - the signature of any follower
        """Refuse to press: the force could not be controlled during a segment. Raises `DeviceError`."""
        raise _refused("press")

    def servo(self) -> NoReturn:
        """Refuse to follow set points: they could not be followed during a segment. Raises `DeviceError`."""
        raise _refused("follow set points")

    @property
    def next(self) -> MotionSegment | None:
        """MotionSegment to move next; None if there is none."""
        return self.reference.next if isinstance(self.reference, SegmentPath) else None

    def take(self) -> None:
        """Take the next segment, if there is one: it cannot be held any more."""
        if isinstance(self.reference, SegmentPath) and not self.reference.ended:
            self.reference.take()

    def hold(self, reason: str | None = "held") -> None:
        """Let no further segment follow.

        Args:
            reason: Reason for the stop; None for the regular end of a motion.
        """
        if not self.reference.ended:
            self.stopped = self.stopped or reason
        self.reference = Reference.standing(self.reference.position)

    def supervise(self) -> None:
        """Hold, and report it, if the force on the tool demands it."""
        force, limit = self._force.magnitude, self._guard.limit
        if not self._guard.exceeded(force):
            return
        self.stopped = self.stopped or "force_limit"
        self.hold()
        text = f"The force on the tool was {force:.1f} N, limit {limit:g} N; the arm stands at the end of its segment. "
        text += "Look at the tool before you continue."
        fields = {"force": force, "limit": limit, "relieved": 0.0}
        self.alarms.append(DeviceEvent(device="robot", code="force_limit", text=text, danger=True, fields=fields))


def _segments(trajectory: JointTrajectory, posture: Floats, model: ArmModel) -> list[MotionSegment]:
    """Return the segments of a checked trajectory; raise `DeviceError` if they are missing or too large.

    The first one counts from where the arm is, since the cabinet moves from there. The trajectory may start elsewhere.

    Args:
        trajectory: The trajectory.
        posture: Present set posture, rad, (n,).
        model: Model of the arm.
    """
    positions, stops = np.array(trajectory.positions), [0, *trajectory.stops]
    last = len(positions) - 1
    if last == 0:
        return []
    if len(stops) == 1 or stops[-1] != last or any(end <= start for start, end in pairwise(stops)):
        text = (
            'The trajectory does not rest often enough: kst.motion is "ptp", so it must be planned in segments. Give '
        )
        text += "the daemon and the robot's node the same configuration."
        raise DeviceError(text, stops=len(trajectory.stops))
    parts = np.abs(np.diff(positions, axis=0)) / trajectory.period / model.velocity
    segments = []
    aside = float((np.abs(posture - positions[0]) / model.velocity).max())
    for start, end in pairwise(stops):
        speed, duration = float(parts[start:end].max()), (end - start) * trajectory.period
        if start == 0:
            duration += aside / max(speed, LEAST_SPEED)
            _check_size(model, posture, positions[end], duration, FIRST)
        else:
            _check_size(model, positions[start], positions[end], duration, COARSE)
        segments.append(MotionSegment(positions[end], speed, duration))
    return segments


def _check_size(model: ArmModel, start: Floats, end: Floats, duration: float, limits: SegmentLimits) -> None:
    base_from_start, base_from_end = model.forward(start), model.forward(end)
    way = float(np.linalg.norm(base_from_end.translation - base_from_start.translation))
    for what, value, limit, shown in (
        ("moves the flange by", way, limits.distance, f"{way * 1e3:.2f} mm, limit {limits.distance * 1e3:g} mm"),
        (
            "turns the flange by",
            turn := rotation_angle(base_from_start, base_from_end),
            limits.angle,
            f"{np.degrees(turn):.2f}°, limit {np.degrees(limits.angle):g}°",
        ),
        ("takes", duration, LONGEST, f"{duration:.2f} s, limit {LONGEST:g} s"),
    ):
        if value > limit * (1.0 + ROUNDING):
            text = f"A segment of the trajectory {what} {shown}: it could not be stopped soon enough; plan it again."
            raise DeviceError(text, value=value, limit=limit)


def _refused(what: str) -> DeviceError:
    text = f'The arm cannot {what}: kst.motion is "ptp", and the cabinet takes no command until a segment has ended.'
    return DeviceError(text, code="point_to_point")
