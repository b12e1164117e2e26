"""Motions of the tool along a straight line."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given

from pcmrs.errors import UnreachableError
from pcmrs.kinematics.trajectory import straight_motion
from pcmrs.spatial import Transform, distance, rotation_angle
from tests.support.trials import examples
from tests.unit.kinematics.motions import ARM, LIMITS, assert_within_joint_limits, seeds
from tests.unit.kinematics.reached_poses import READY


@examples(10)
@given(seeds)
def test_straight_motion_keeps_the_line_and_every_limit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tool = Transform.from_rotvec(rng.uniform(-0.1, 0.1, 3), rng.uniform(-0.5, 0.5, 3))
    start = ARM.forward(READY) @ tool
    goal = start @ Transform.from_rotvec(rng.uniform(-0.06, 0.06, 3), rng.uniform(-0.2, 0.2, 3))
    trajectory = straight_motion(ARM, READY, goal @ tool.inverse(), LIMITS, flange_from_tool=tool)
    assert trajectory.positions[0] == READY.tolist()
    tools = [ARM.forward(q) @ tool for q in trajectory.positions]
    assert distance(tools[-1], goal) < 1e-9
    assert rotation_angle(tools[-1], goal) < 1e-9
    length, angle = distance(start, goal), rotation_angle(start, goal)
    for pose in tools:
        assert distance(start, pose) + distance(pose, goal) == pytest.approx(length, abs=1e-9)
        assert rotation_angle(start, pose) + rotation_angle(pose, goal) == pytest.approx(angle, abs=1e-8)
        assert distance(start, pose) * angle == pytest.approx(rotation_angle(start, pose) * length, abs=1e-8)
    assert_within_joint_limits(trajectory)
    steps = [distance(a, b) for a, b in itertools.pairwise(tools)]
    assert max(steps) <= LIMITS.linear_velocity * trajectory.period * (1 + 1e-6)
    turns = [rotation_angle(a, b) for a, b in itertools.pairwise(tools)]
    assert max(turns) <= LIMITS.angular_velocity * trajectory.period * (1 + 1e-6)


def test_straight_motion_is_stretched_where_a_joint_is_too_fast() -> None:
    tool_in_a_hurry = dataclasses.replace(
        LIMITS, linear_velocity=2.0, linear_acceleration=20.0, angular_velocity=5.0, linear_jerk=400.0
    )
    goal = ARM.forward(READY) @ Transform.from_rotvec((0.1, 0.1, -0.1), (0.1, 0.2, 0.5))
    trajectory = straight_motion(ARM, READY, goal, tool_in_a_hurry)
    assert_within_joint_limits(trajectory)
    assert distance(ARM.forward(trajectory.positions[-1]), goal) < 1e-9


@pytest.mark.parametrize("seed", [3, 80, 180])
def test_stretched_line_keeps_the_limits_at_its_new_samples(seed: int) -> None:
    """Lines past singularities: stretched once, the joints exceed their jerk by 4 %, 11 % and 23 %."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(ARM.lower, ARM.upper)
    goal = Transform.from_rotvec(rng.uniform(-0.1, 0.1, 3), np.zeros(3)) @ ARM.forward(start)
    trajectory = straight_motion(ARM, start, goal, LIMITS)
    assert_within_joint_limits(trajectory)
    assert distance(ARM.forward(trajectory.positions[-1]), goal) < 1e-9


def test_straight_motion_can_turn_about_the_tool_point_only() -> None:
    tool = Transform.from_rotvec((0.05, 0, 0.2), (0, 0, 0))
    tip = ARM.forward(READY) @ tool
    goal = tip @ Transform.from_rotvec((0, 0, 0), (0.3, 0, 0)) @ tool.inverse()
    trajectory = straight_motion(ARM, READY, goal, LIMITS, flange_from_tool=tool)
    assert max(distance(ARM.forward(q) @ tool, tip) for q in trajectory.positions) < 1e-9


def test_straight_motion_to_where_the_arm_is_stays_there() -> None:
    trajectory = straight_motion(ARM, READY, ARM.forward(READY), LIMITS)
    assert trajectory.positions == [READY.tolist()]


def test_a_line_that_leaves_the_workspace_is_refused() -> None:
    goal = Transform.from_rotvec((0, 0, 1.0), (0, 0, 0)) @ ARM.forward(READY)
    with pytest.raises(UnreachableError, match=r"followed for \d+ %") as caught:
        straight_motion(ARM, READY, goal, LIMITS)
    assert 0.0 < caught.value.fields["parameter"] < 1.0


def test_a_joint_never_swings_beyond_its_limit_between_two_knots() -> None:
    """A line that ends where a joint comes to rest at its limit is refused there."""
    refused: list[float] = []
    rng = np.random.default_rng(3)
    for _ in range(40):
        start = rng.uniform(ARM.lower, ARM.upper)
        joint = int(rng.integers(7))
        start[joint] = ARM.upper[joint] - rng.uniform(0.0, 0.03)
        way = Transform.from_rotvec(rng.uniform(-0.05, 0.05, 3), np.zeros(3))
        try:
            trajectory = straight_motion(ARM, start, way @ ARM.forward(start), LIMITS)
        except UnreachableError as error:
            refused.append(error.fields["parameter"])
            continue
        positions = np.array(trajectory.positions)
        assert np.all(positions <= ARM.upper + 1e-6)
        assert np.all(positions >= ARM.lower - 1e-6)
    assert 0 < len(refused) < 40
    assert all(0.0 <= parameter <= 1.0 for parameter in refused)
