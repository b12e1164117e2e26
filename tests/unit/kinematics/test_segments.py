"""Motions in segments: each is short, slow and exact at its end."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.errors import UnreachableError
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.segments import COARSE, FINE, PERIOD, PLANNED_DURATION, in_segments
from pcmrs.kinematics.straight import straight_motion
from pcmrs.kinematics.trajectory import concatenate, joint_motion
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform, rotation_angle

ARM = ArmModel(ARMS["iiwa14"])
HOME = np.array(ARM.facts.home)
TOOL = Transform(np.eye(3), np.array([0.0, 0.06, 0.2]))
LIMITS = MotionLimits((0.5,) * 7, (2.5,) * 7, (15.0,) * 7, 0.2, 0.5, 3.0, 0.6, 1.5)
SLOWEST = 0.05


def line(height: float) -> JointTrajectory:
    """Straight motion of the tool along its own axis from the home posture."""
    goal = ARM.forward(HOME) @ TOOL @ Transform(np.eye(3), np.array([0.0, 0.0, height])) @ TOOL.inverse()
    return straight_motion(ARM, HOME, goal, LIMITS, flange_from_tool=TOOL)


def tool(posture: list[float]) -> Transform:
    return ARM.forward(posture) @ TOOL


def ends(path: JointTrajectory) -> list[list[float]]:
    return [path.positions[0], *(path.positions[stop] for stop in path.stops)]


@pytest.mark.parametrize(("fine", "size"), [(0.0, COARSE), (1.0, FINE)], ids=["coarse", "fine"])
def test_no_segment_is_longer_than_its_limits(fine: float, size: object) -> None:
    path = in_segments(ARM, line(-0.04), LIMITS, SLOWEST, TOOL, fine)
    limits = COARSE if size is COARSE else FINE
    for start, end in zip(ends(path)[:-1], ends(path)[1:], strict=True):
        assert np.linalg.norm(tool(end).translation - tool(start).translation) <= limits.distance * 1.001
        assert rotation_angle(tool(start), tool(end)) <= limits.angle * 1.001
    durations = np.diff([0, *path.stops]) * PERIOD
    assert durations.max() <= PLANNED_DURATION + PERIOD
    assert path.positions[-1] == line(-0.04).positions[-1]
    assert len(path.stops) >= round(0.04 / limits.distance)


def test_only_the_beginning_of_a_retreat_has_short_segments() -> None:
    path = in_segments(ARM, line(0.06), LIMITS, SLOWEST, TOOL, 0.02)
    ways = [
        float(np.linalg.norm(tool(b).translation - tool(a).translation))
        for a, b in zip(ends(path)[:-1], ends(path)[1:], strict=True)
    ]
    assert max(ways[:20]) <= FINE.distance * 1.001
    assert max(ways) > 3 * FINE.distance


def test_a_slower_limit_is_kept_within_every_segment() -> None:
    path = in_segments(ARM, line(-0.02), LIMITS, 0.004, TOOL, 1.0)
    places = np.array([tool(posture).translation for posture in path.positions])
    assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() / PERIOD <= 0.004 * 1.05


def test_a_joint_that_turns_where_the_tool_stays_counts() -> None:
    """The elbow of a seven-joint arm can swing while the flange stands."""
    goal: Floats = HOME.copy()
    goal[6] += 0.3  # the flange turns in place
    path = in_segments(ARM, joint_motion(ARM, HOME, goal, LIMITS), LIMITS, SLOWEST, TOOL)
    assert len(path.stops) >= round(0.3 / COARSE.angle)


def test_a_motion_of_one_posture_has_no_segments() -> None:
    here = JointTrajectory(period=0.005, positions=[HOME.tolist()])
    assert in_segments(ARM, here, LIMITS, SLOWEST, TOOL).stops == []


def test_joined_motions_rest_where_both_did() -> None:
    out = in_segments(ARM, line(0.01), LIMITS, SLOWEST, TOOL)
    home = joint_motion(ARM, out.positions[-1], HOME, LIMITS)
    both = concatenate(out, in_segments(ARM, home, LIMITS, SLOWEST, TOOL))
    assert both.stops[-1] == len(both.positions) - 1
    assert both.stops[: len(out.stops)] == out.stops
    assert both.duration > both.period * len(both.positions)


def test_a_jump_of_joints_is_no_path_of_segments() -> None:
    """Where the joints turn too far within one step of the path, no segment is slow enough."""
    slow = MotionLimits((1e-4,) * 7, (2.5,) * 7, (15.0,) * 7, 0.2, 0.5, 3.0, 0.6, 1.5)
    with pytest.raises(UnreachableError, match="plan another pose"):
        in_segments(ARM, line(0.01), slow, SLOWEST, TOOL)
