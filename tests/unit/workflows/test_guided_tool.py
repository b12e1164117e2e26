"""However a teleoperator steers, the tool stays within its bounds, and is never quicker than it may be."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.spatial import Floats, Transform
from pcmrs.workflows._guided_tool import PlanLimits
from pcmrs.workflows._setpoints import limit_twist
from pcmrs.workflows.settings import TeleoperationSettings

SETTINGS = TeleoperationSettings(range=0.03, turn_deg=10.0)
PERIOD = SETTINGS.period
TURN = math.radians(SETTINGS.turn_deg)
numbers = st.floats(-1.0, 1.0)
twists = st.tuples(*[numbers] * 6).map(lambda six: np.array(six))
courses = st.lists(st.tuples(twists, st.integers(1, 80)), min_size=1, max_size=5)


def walk(limits: PlanLimits, pose: Transform, course: list[tuple[Floats, int]]) -> list[tuple[Transform, Floats]]:
    """Poses and twists as the tool is guided, without an arm and zones."""
    found, velocity = [], np.zeros(6)
    for asked, steps in course:
        for _ in range(steps):
            wanted = limit_twist(asked, SETTINGS.linear_velocity, SETTINGS.angular_velocity)
            velocity = limits.bounded(pose, wanted, PERIOD)
            after = pose @ Transform.from_rotvec(velocity[:3] * PERIOD, velocity[3:] * PERIOD)
            pose = after if limits.allow(pose, after) else pose
            found.append((pose, velocity))
    return found


@given(courses)
def test_a_tool_never_leaves_its_bounds(course: list[tuple[Floats, int]]) -> None:
    begin = Transform(np.eye(3), np.array((0.0, 0.0, 0.01)))
    for pose, velocity in walk(PlanLimits(SETTINGS), begin, course):
        assert pose.translation[2] >= -1e-6
        assert np.linalg.norm(pose.translation) <= SETTINGS.range + 1e-6
        assert np.linalg.norm(pose.rotvec) <= TURN + 1e-6
        assert np.linalg.norm(velocity[:3]) <= SETTINGS.linear_velocity + 1e-9
        assert np.linalg.norm(velocity[3:]) <= SETTINGS.angular_velocity + 1e-9


@given(twists)
def test_a_tool_beyond_a_bound_may_only_come_back(asked: Floats) -> None:
    below = Transform.from_rotvec((0.0, 0.0, -0.002), (0.0, 0.3, 0.0))
    before = below
    for pose, _ in walk(PlanLimits(SETTINGS), below, [(asked, 30)]):
        assert pose.translation[2] >= before.translation[2] - 1e-8
        assert np.linalg.norm(pose.rotvec) <= np.linalg.norm(before.rotvec) + 1e-8
        before = pose


@pytest.mark.parametrize(
    ("towards", "what"),
    [((0, 0, -1, 0, 0, 0), "height"), ((1, 0, 0, 0, 0, 0), "range"), ((0, 0, 0, 0, 0, 1), "turn")],
)
def test_a_bound_is_reached_and_braked_before_without_a_jerk(towards: tuple[float, ...], what: str) -> None:
    limits, begin = PlanLimits(SETTINGS), Transform(np.eye(3), np.array((0.0, 0.0, 0.02)))
    found = walk(limits, begin, [(np.array(towards, dtype=float), 700)])
    assert limits.met(found[-1][0]) == what
    speeds = np.array([velocity for _, velocity in found])
    changes = (
        np.linalg.norm(np.diff(speeds, axis=0)[:, :3], axis=1),
        np.linalg.norm(np.diff(speeds, axis=0)[:, 3:], axis=1),
    )
    assert changes[0].max() <= SETTINGS.linear_acceleration * PERIOD + 1e-9
    assert changes[1].max() <= SETTINGS.angular_acceleration * PERIOD + 1e-9
