"""Motions in segments, for a controller that can stop an arm only at the end of a point-to-point motion.

Every segment moves all joints together from rest to rest, on a straight line of joint space, as such a controller does.
It is so short and so slow that an arm which gets no next segment stands soon, and not far away.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import ceil, radians

import numpy as np

from pcmrs.errors import UnreachableError
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.time_parameterization import joint_request, sample_times, solve
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform

LONGEST = 0.5
"""Longest duration of a segment, s: no arm may move for longer after a Stop."""
PLANNED_DURATION = 0.4
"""Longest planned duration of a segment, s. The rest of `LONGEST` is for the controller's reaction."""
LARGEST_TURN = 0.015
"""Largest turn of any joint in a segment, rad: less than the displacement that counts as a motion without a request."""
PERIOD = 0.02
"""Time between the samples of a motion in segments, s. Only the ends of its segments are sent to the controller."""
_KNOTS = 5
"""Least number of places per segment between which its end is chosen."""


@dataclass(frozen=True, slots=True)
class SegmentLimits:
    """Size of a segment.

    Attributes:
        distance: Longest way of the tool point, the flange and each joint's origin, m.
        angle: Largest rotation of the tool, rad.
    """

    distance: float
    angle: float


COARSE = SegmentLimits(0.005, radians(1.0))
"""Size of a segment away from the body."""
FINE = SegmentLimits(0.001, radians(0.2))
"""Size of a segment between standoff and target."""


def in_segments(
    arm: ArmModel,
    trajectory: JointTrajectory,
    limits: MotionLimits,
    slowest: float,
    flange_from_tool: Transform,
    fine: float = 0.0,
) -> JointTrajectory:
    """Return a motion along the path of another one that rests after each segment.

    Args:
        arm: Model of the arm.
        trajectory: Planned motion from rest to rest; only its path is used.
        limits: Limits of the joints.
        slowest: Greatest speed of the tool point in every segment, m/s.
        flange_from_tool: Pose of the tool point in the flange.
        fine: Way of the tool point from the start within which segments have the size `FINE`, m; `COARSE` after it.

    Raises:
        UnreachableError: The path turns a joint so fast where the tool hardly moves that no segment is slow enough.
    """
    if len(trajectory.positions) == 1:
        return JointTrajectory(period=PERIOD, positions=trajectory.positions)
    path = _Path(arm, np.array(trajectory.positions), flange_from_tool)
    largest = _largest_turn(limits)
    positions, stops = [path.postures[0].tolist()], []
    start = 0
    while start < path.last:
        size = FINE if path.travelled[start] < fine else COARSE
        reach = SegmentLimits(min(size.distance, slowest * PLANNED_DURATION / 2.0), size.angle)
        end = path.farthest(start, reach, largest)
        positions += _segment(path, start, end, limits, slowest)
        stops.append(len(positions) - 1)
        start = end
    return JointTrajectory(period=PERIOD, positions=positions, stops=stops)


class _Path:
    """Postures along a path, closely spaced, with the places of the arm's points.

    Args:
        arm: Model of the arm.
        positions: Postures along the path, rad, (N, n).
        flange_from_tool: Pose of the tool point in the flange.

    Attributes:
        postures: Postures, rad, (M, n).
        travelled: Way of the tool point up to each posture, m, (M,).
        last: Index of the last posture.
    """

    def __init__(self, arm: ArmModel, positions: Floats, flange_from_tool: Transform) -> None:
        self._arm, self._flange_from_tool = arm, flange_from_tool
        points, rotations = self._places(positions)
        steps = _ways(points[1:], points[:-1]) / FINE.distance, _angles(rotations[1:], rotations[:-1]) / FINE.angle
        parts = max(1, ceil(_KNOTS * float(np.maximum(*steps).max())))
        self.postures = _refined(positions, parts)
        self._points, self._rotations = self._places(self.postures)
        tool = self._points[:, -1]
        self.travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(tool, axis=0), axis=1))))
        self.last = len(self.postures) - 1

    def farthest(self, start: int, size: SegmentLimits, largest_turn: Floats) -> int:
        """Return the index of the farthest posture that one segment may reach from another one.

        Args:
            start: Index of the posture at its start.
            size: Size of a segment.
            largest_turn: Largest turn of each joint in a segment, rad, (n,).

        Raises:
            UnreachableError: Even the next posture is too far.
        """
        end = start
        while end < self.last:
            then = slice(end + 1, end + 2)
            way, angle = self._way(start, then), self._angle(start, then)
            turn = np.abs(self.postures[end + 1] - self.postures[start])
            if way > size.distance or angle > size.angle or bool(np.any(turn > largest_turn)):
                break
            end += 1
        if end == start:
            text = "The arm cannot make this motion in segments that are short and slow enough; plan another pose."
            raise UnreachableError(text, distance=size.distance)
        return end

    def tool_way(self, start: int, end: int) -> float:
        """Return the way of the tool point between two postures, m."""
        return float(self.travelled[end] - self.travelled[start])

    def _way(self, start: int, then: slice) -> float:
        return float(_ways(self._points[then], self._points[start])[0])

    def _angle(self, start: int, then: slice) -> float:
        return float(_angles(self._rotations[then], self._rotations[start])[0])

    def _places(self, postures: Floats) -> tuple[Floats, Floats]:
        """Return the origins of the joints, the flange and the tool point, m, (M, n + 2, 3), and the flange's axes."""
        points, rotations = [], []
        for posture in postures:
            flange = self._arm.forward(posture)
            tool = flange @ self._flange_from_tool.translation
            points.append(np.vstack((self._arm.joint_origins(posture), flange.translation, tool)))
            rotations.append(flange.rotation)
        return np.array(points), np.array(rotations)


def _segment(path: _Path, start: int, end: int, limits: MotionLimits, slowest: float) -> list[list[float]]:
    """Return the samples of a segment without its start; the last one is exactly its end."""
    first, last = path.postures[start], path.postures[end]
    request = joint_request(np.array(limits.joint_velocity), limits)
    request.current_position, request.target_position = first.tolist(), last.tolist()
    profile = solve(request)
    # The tool's greatest speed is twice the mean of a motion that only speeds up and slows down.
    duration = max(profile.duration, 2.0 * path.tool_way(start, end) / slowest)
    times = sample_times(profile.duration, duration / profile.duration, PERIOD)
    samples: list[list[float]] = [profile.at_time(time)[0] for time in times.tolist()][1:-1]
    return [*samples, last.tolist()]


def _largest_turn(limits: MotionLimits) -> Floats:
    """Return the farthest that each joint can turn from rest to rest within `PLANNED_DURATION`, rad, (n,)."""
    velocity, acceleration, jerk = (
        np.array(each) for each in (limits.joint_velocity, limits.joint_acceleration, limits.joint_jerk)
    )
    time = PLANNED_DURATION
    # Eight equal ramps of the acceleration, if it does not reach its limit; otherwise with a constant part.
    jerky = 2.0 * jerk * (time / 4.0) ** 3
    full = acceleration / 4.0 * np.maximum(time**2 - 2.0 * time * acceleration / jerk, 0.0)
    turn = np.where(jerk * time / 4.0 <= acceleration, jerky, full)
    return np.minimum(np.minimum(turn, velocity * time / 2.0), LARGEST_TURN)


def _refined(positions: Floats, parts: int) -> Floats:
    """Return postures with `parts` equal parts between each two of them, rad, (M, n)."""
    shares = np.arange(parts)[:, None] / parts
    between = [first + shares * (second - first) for first, second in pairwise(positions)]
    return np.vstack((*between, positions[-1:]))


def _ways(ends: Floats, starts: Floats) -> Floats:
    """Return the longest way of any point between two sets of places, m, (M,)."""
    ways: Floats = np.linalg.norm(ends - starts, axis=-1).max(axis=-1)
    return ways


def _angles(ends: Floats, starts: Floats) -> Floats:
    """Return the angles between rotations, rad, (M,)."""
    # |R - S| = 2 sqrt(2) sin(angle / 2) in the Frobenius norm, which is exact for small angles, too.
    chords = np.linalg.norm(ends - starts, axis=(-2, -1)) / (2.0 * np.sqrt(2.0))
    angles: Floats = 2.0 * np.arcsin(np.clip(chords, 0.0, 1.0))
    return angles
