"""Follower of segments: what it refuses, and that nothing follows a hold."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.devices.kst._arm import TorqueForce
from pcmrs.devices.motion.follower import brake_limits
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.motion.segments import SegmentFollower
from pcmrs.errors import DeviceError
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.segments import in_segments
from pcmrs.kinematics.trajectory import joint_motion
from pcmrs.messages import JointTrajectory, PressRequest
from pcmrs.spatial import Transform
from tests.unit.devices.kst_peer import MODEL, START, torques_of

LIMITS = MotionLimits((0.5,) * 7, (2.5,) * 7, (15.0,) * 7, 0.2, 0.5, 3.0, 0.6, 1.5)


def stepped(turn: float = 0.05) -> JointTrajectory:
    """Motion of all joints by `turn`, rad, in segments."""
    return in_segments(MODEL, joint_motion(MODEL, START, START + turn, LIMITS), LIMITS, 0.05, Transform.identity())


@pytest.fixture
def force() -> TorqueForce:
    return TorqueForce(MODEL, np.array([0.0, 0.0, -1.0]))


@pytest.fixture
def follower(force: TorqueForce) -> SegmentFollower:
    return SegmentFollower(MODEL, brake_limits(MODEL.facts, 10.0, 200.0), ForceSettings(), force, START, 0.005)


def test_all_segments_are_taken_in_order(follower: SegmentFollower) -> None:
    path = stepped()
    follower.follow(path)
    goals = []
    while (segment := follower.next) is not None:
        assert segment.duration <= 0.5
        assert 0.0 < segment.speed < 1.0
        follower.take()
        goals.append(segment.goal.tolist())
    assert goals == [path.positions[stop] for stop in path.stops]
    assert follower.reference.ended
    assert follower.stopped is None


def test_after_a_hold_no_segment_follows(follower: SegmentFollower) -> None:
    follower.follow(stepped())
    follower.take()
    goal = follower.reference.position.tolist()
    follower.hold()
    assert follower.next is None
    assert follower.stopped == "held"
    assert follower.reference.position.tolist() == goal, "it stands at the end of the segment that was under way"


def test_a_force_lets_no_segment_follow(follower: SegmentFollower, force: TorqueForce) -> None:
    follower.follow(stepped())
    follower.take()
    force.update(START, torques_of(np.array([0.0, 0.0, 30.0])))
    follower.supervise()
    assert follower.next is None
    assert follower.stopped == "force_limit"
    assert [alarm.code for alarm in follower.alarms] == ["force_limit"]
    follower.supervise()
    assert len(follower.alarms) == 1, "the same force is reported once"


def test_streams_are_refused_with_the_reason(follower: SegmentFollower) -> None:
    request = PressRequest(force=2.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.005, speed=0.01, timeout=5.0)
    with pytest.raises(DeviceError, match="takes no command until a segment has ended"):
        follower.press(request)
    with pytest.raises(DeviceError, match="takes no command until a segment has ended"):
        follower.servo()
    assert follower.reference.ended


@pytest.mark.parametrize("stops", [[], [3], [40, 3]], ids=["none", "not_to_the_end", "backwards"])
def test_a_motion_without_its_segments_is_refused(follower: SegmentFollower, stops: list[int]) -> None:
    path = stepped()
    with pytest.raises(DeviceError, match="same configuration"):
        follower.follow(JointTrajectory(period=path.period, positions=path.positions, stops=stops))
    assert follower.reference.ended


def test_a_segment_that_is_too_long_is_refused(follower: SegmentFollower) -> None:
    path = stepped()
    last = len(path.positions) - 1
    with pytest.raises(DeviceError, match="could not be stopped soon enough"):
        follower.follow(JointTrajectory(period=path.period, positions=path.positions, stops=[last]))
    assert follower.reference.ended


@pytest.mark.parametrize("joint", range(4))
def test_the_first_segment_counts_from_where_the_arm_is(force: TorqueForce, joint: int) -> None:
    """A start that is just accepted must not make the first segment larger than one that can be stopped."""
    here = START.copy()
    here[joint] -= 0.0195
    follower = SegmentFollower(MODEL, brake_limits(MODEL.facts, 10.0, 200.0), ForceSettings(), force, here, 0.005)
    with pytest.raises(DeviceError, match=r"(moves|turns) the flange by"):
        follower.follow(stepped())
    assert follower.reference.ended


def test_a_small_deviation_at_rest_is_no_reason_to_refuse(force: TorqueForce) -> None:
    here = START - 2e-4
    follower = SegmentFollower(MODEL, brake_limits(MODEL.facts, 10.0, 200.0), ForceSettings(), force, here, 0.005)
    path = stepped()
    follower.follow(path)
    first = follower.next
    assert first is not None
    assert first.duration > path.stops[0] * path.period
