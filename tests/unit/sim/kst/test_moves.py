"""Motions of the virtual cabinet: from rest to rest, within the speed that was asked, and refusals."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import DeviceError, UnreachableError
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.kst.moves import ACCELERATION, circular_move, joint_move, straight_move
from tests.support.trials import examples
from tests.unit.sim.simulated_arms import FACTS, HOME

MODEL = ArmModel(FACTS)
TOOL = Transform.from_rotvec((0.0, 0.0, 0.15), (0.0, 0.0, 0.5))
changes = st.lists(st.floats(-0.5, 0.5), min_size=7, max_size=7).map(np.array)


def speeds(motion: JointTrajectory) -> Floats:
    return np.asarray(np.diff(motion.positions, axis=0) / motion.period)


@examples(20)
@given(changes, st.floats(0.05, 1.0))
def test_joints_go_from_rest_to_rest_within_the_fraction(change: Floats, fraction: float) -> None:
    motion = joint_move(MODEL, HOME, HOME + change, fraction)
    assert motion.positions[0] == pytest.approx(HOME, abs=1e-9)
    assert motion.positions[-1] == pytest.approx(HOME + change, abs=1e-6)
    assert np.all(np.abs(speeds(motion)) <= fraction * np.array(MODEL.velocity) + 1e-6)
    rates = np.vstack((np.zeros(7), speeds(motion), np.zeros(7)))
    assert np.abs(np.diff(rates, axis=0)).max() / motion.period <= 1.05 * ACCELERATION


def test_all_joints_start_and_end_together() -> None:
    motion = joint_move(MODEL, HOME, HOME + np.array((0.5, 0.1, 0.0, 0.0, -0.1, 0.0, 0.01)), 0.3)
    moving = np.abs(speeds(motion)) > 1e-9
    ends = [np.flatnonzero(moving[:, joint])[[0, -1]].tolist() for joint in (0, 1, 4, 6)]
    assert np.ptp(ends, axis=0).max() <= 2


@pytest.mark.parametrize("fraction", [0.0, 0.009, 1.01, float("nan")])
def test_a_fraction_out_of_range_is_refused(fraction: float) -> None:
    with pytest.raises(DeviceError, match=r"must be in \[0\.01, 1\]"):
        joint_move(MODEL, HOME, HOME + 0.1, fraction)


def test_a_goal_out_of_the_range_of_a_joint_is_refused() -> None:
    goal = HOME.copy()
    goal[1] = MODEL.upper[1] + 0.01
    with pytest.raises(UnreachableError):
        joint_move(MODEL, HOME, goal, 0.3)


def test_the_tool_frame_moves_on_a_line_at_its_speed() -> None:
    start = MODEL.forward(HOME) @ TOOL
    offset = np.array((0.02, -0.03, 0.04))
    motion = straight_move(MODEL, HOME, Transform(start.rotation, start.translation + offset), TOOL, 0.05)
    places = np.array([(MODEL.forward(posture) @ TOOL).translation for posture in motion.positions])
    along = (places - start.translation) @ offset / np.linalg.norm(offset)
    aside = places - start.translation - np.outer(along, offset / np.linalg.norm(offset))
    assert np.linalg.norm(aside, axis=1).max() < 1e-4
    assert along[-1] == pytest.approx(np.linalg.norm(offset), abs=1e-5)
    assert 0.0 <= np.diff(along).max() / motion.period <= 0.05 * 1.01
    turned = (MODEL.forward(motion.positions[-1]) @ TOOL).rotation
    assert turned == pytest.approx(start.rotation, abs=1e-5)


@pytest.mark.parametrize(
    ("place", "speed", "text"),
    [
        ((0.5, 0.0, 0.5), 0.0009, "must be 0.001 or more"),
        ((0.5, 0.0, 0.5), float("nan"), "must be 0.001 or more"),
        ((0.5, 11.0, 0.5), 0.05, "more than 10 m"),
    ],
)
def test_an_impossible_line_is_refused(place: tuple[float, float, float], speed: float, text: str) -> None:
    goal = Transform(np.eye(3), np.array(place))
    with pytest.raises(DeviceError, match=text):
        straight_move(MODEL, HOME, goal, TOOL, speed)


def test_a_line_beyond_the_reach_is_refused() -> None:
    goal = MODEL.forward(HOME) @ TOOL
    with pytest.raises(UnreachableError):
        straight_move(MODEL, HOME, Transform(goal.rotation, np.array((2.0, 0.0, 0.5))), TOOL, 0.05)


@pytest.mark.parametrize(("middle", "angle"), [((0.02, 0.02), 180.0), ((0.02, -0.02), 180.0), ((0.04, -0.04), 270.0)])
def test_the_tool_frame_moves_on_an_arc_at_its_speed(middle: tuple[float, float], angle: float) -> None:
    start = MODEL.forward(HOME) @ TOOL
    through, end = ((start @ Transform(np.eye(3), np.array((x, y, 0.0)))) for x, y in (middle, (0.04, 0.0)))
    end = end @ Transform.from_rotvec(np.zeros(3), (0.0, 0.0, 0.2))
    motion = circular_move(MODEL, HOME, through, end, TOOL, 0.05)
    poses = [start.inverse() @ MODEL.forward(posture) @ TOOL for posture in motion.positions]
    places = np.array([pose.translation for pose in poses])
    radius = 0.02 / np.sin(np.radians(angle / 2.0))
    centre = np.array((0.02, np.copysign(1.0, middle[1]) * -radius * np.cos(np.radians(angle / 2.0)), 0.0))
    assert np.linalg.norm(places - centre, axis=1) == pytest.approx(np.full(len(places), radius), abs=1e-4)
    assert np.abs(places - (start.inverse() @ through).translation).max(axis=1).min() < 5e-4, "it passes the middle"
    assert poses[-1].translation == pytest.approx((0.04, 0.0, 0.0), abs=1e-5)
    assert poses[-1].rotvec == pytest.approx((0.0, 0.0, 0.2), abs=1e-4)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert steps.max() / motion.period <= 0.05 * 1.01
    assert steps.sum() == pytest.approx(radius * np.radians(angle), rel=1e-2)
    assert np.all(np.abs(speeds(motion)) <= np.array(MODEL.velocity) * 1.001)


@pytest.mark.parametrize(
    ("middle", "text"), [((0.02, 0.0, 0.0), "on a line"), ((0.02, 1e-5, 0.0), "must be at most 10 m")]
)
def test_an_impossible_circle_is_refused(middle: tuple[float, float, float], text: str) -> None:
    start = MODEL.forward(HOME) @ TOOL
    through = start @ Transform(np.eye(3), np.array(middle) * (-1.0 if "10 m" in text else 1.0))
    end = start @ Transform(np.eye(3), np.array((0.04, 0.0, 0.0)))
    with pytest.raises(DeviceError, match=text):
        circular_move(MODEL, HOME, through, end, TOOL, 0.05)
