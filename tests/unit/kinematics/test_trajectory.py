import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import ConfigurationError, GeometryError, UnreachableError
from pcmrs.kinematics.arms import IIWA14_R820
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.trajectory import MotionLimits, brake, concatenate, joint_motion, straight_motion
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Transform, distance, rotation_angle
from tests.support.trials import examples

ARM = ArmModel(IIWA14_R820)
READY = np.array((0.1, 0.5, 0.2, -1.2, 0.3, 0.9, 0.1))
LIMITS = MotionLimits(
    joint_velocity=(0.8,) * 7,
    joint_acceleration=(2.0,) * 7,
    joint_jerk=(20.0,) * 7,
    linear_velocity=0.2,
    linear_acceleration=0.5,
    linear_jerk=4.0,
    angular_velocity=0.5,
    angular_acceleration=2.0,
)
UNHURRIED_TOOL = dataclasses.replace(LIMITS, linear_velocity=100.0)
seeds = st.integers(0, 2**32 - 1)


def derivative(trajectory: JointTrajectory, order: int) -> np.ndarray:
    """The greatest n-th derivative of each joint, by differences; the arm rests before and after."""
    padded = np.pad(np.array(trajectory.positions), ((3, 3), (0, 0)), mode="edge")
    return np.asarray(np.abs(np.diff(padded, order, axis=0)).max(axis=0) / trajectory.period**order)


def assert_within_joint_limits(trajectory: JointTrajectory) -> None:
    for order, bound in enumerate((LIMITS.joint_velocity, LIMITS.joint_acceleration, LIMITS.joint_jerk), start=1):
        assert np.all(derivative(trajectory, order) <= np.array(bound) * (1 + 1e-6))


def flange_speed(trajectory: JointTrajectory) -> float:
    """The greatest, m/s."""
    places = [ARM.forward(q).translation for q in trajectory.positions]
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).max()) / trajectory.period


@examples(20)
@given(seeds)
def test_joint_motion_is_exact_at_its_ends_and_keeps_every_limit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    start, goal = rng.uniform(ARM.lower, ARM.upper, (2, 7))
    trajectory = joint_motion(ARM, start, goal, LIMITS)
    assert trajectory.positions[0] == start.tolist()
    assert trajectory.positions[-1] == goal.tolist()
    assert_within_joint_limits(trajectory)
    assert flange_speed(trajectory) <= LIMITS.linear_velocity * 1.001


def test_joint_motion_uses_the_speed_it_is_given() -> None:
    goal = READY + np.eye(7)[0]
    free = joint_motion(ARM, READY, goal, UNHURRIED_TOOL)
    assert derivative(free, 1).max() == pytest.approx(0.8, rel=0.01)
    assert flange_speed(joint_motion(ARM, READY, goal, LIMITS)) == pytest.approx(0.2, rel=0.01)


def test_joint_motion_never_exceeds_the_arm() -> None:
    fast = dataclasses.replace(UNHURRIED_TOOL, joint_velocity=(9.0,) * 7, joint_acceleration=(50.0,) * 7)
    trajectory = joint_motion(ARM, -0.9 * ARM.upper, 0.9 * ARM.upper, fast)
    assert np.all(derivative(trajectory, 1) <= ARM.velocity * (1 + 1e-6))


def test_joint_motion_to_where_the_arm_is_stays_there() -> None:
    assert np.ptp(joint_motion(ARM, READY, READY, LIMITS).positions, axis=0).max() == 0.0


@given(exponent=st.floats(-17.0, -2.0), joint=st.integers(0, 6))
@examples(60)
def test_no_way_is_too_short(exponent: float, joint: int) -> None:
    """The arm comes to rest beside its goal by what is left of its control: it may be sent there again."""
    goal = np.array(READY)
    goal[joint] += 10.0**exponent
    for trajectory in (joint_motion(ARM, READY, goal, LIMITS), straight_motion(ARM, READY, ARM.forward(goal), LIMITS)):
        assert np.abs(np.array(trajectory.positions) - READY).max() <= 1.01 * 10.0**exponent + 1e-12
        assert distance(ARM.forward(trajectory.positions[-1]), ARM.forward(goal)) < 2e-6


def test_joint_motion_beyond_a_limit_is_refused() -> None:
    with pytest.raises(UnreachableError, match="joint_1"):
        joint_motion(ARM, READY, ARM.upper + 0.1, LIMITS)


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


def test_trajectories_join_where_they_meet() -> None:
    up = ARM.forward(READY) @ Transform.from_rotvec((0, 0, -0.03), (0, 0, 0))
    there = joint_motion(ARM, np.zeros(7), READY, LIMITS)
    on = straight_motion(ARM, READY, up, LIMITS)
    both = concatenate(there, on)
    assert both.positions[: len(there.positions)] == there.positions
    assert both.positions[len(there.positions) - 1 :] == on.positions
    assert_within_joint_limits(both)
    with pytest.raises(GeometryError, match="gap"):
        concatenate(on, there)
    with pytest.raises(GeometryError, match="periods"):
        concatenate(there, straight_motion(ARM, READY, up, LIMITS, period=0.01))


@given(seeds)
def test_braking_stops_every_joint_within_its_limits(seed: int) -> None:
    velocities = np.random.default_rng(seed).uniform(-1.4, 1.4, 7)
    trajectory = brake(READY.tolist(), velocities.tolist(), LIMITS, period=0.001)
    positions = np.array(trajectory.positions)
    np.testing.assert_array_equal(positions[0], READY)
    # The motion before it, at constant velocity, belongs to the differences at its start.
    run_up = READY - np.outer((0.003, 0.002, 0.001), velocities)
    whole = np.concatenate((run_up, positions, positions[-1:].repeat(3, axis=0)))
    for order, bound in ((2, 2.0), (3, 20.0)):
        assert np.abs(np.diff(whole, order, axis=0)).max() / 0.001**order <= bound * (1 + 1e-4)
    # Symmetric ramps of jerk j to acceleration a at most: v/a + a/j, or 2 sqrt(v/j) where a is not reached.
    fastest = np.abs(velocities).max()
    shortest = fastest / 2.0 + 2.0 / 20.0 if fastest > 2.0**2 / 20.0 else 2.0 * np.sqrt(fastest / 20.0)
    assert (len(positions) - 1) * 0.001 == pytest.approx(shortest, abs=0.0011)


def test_an_arm_at_rest_has_nothing_to_brake() -> None:
    assert brake(READY.tolist(), [0.0] * 7, LIMITS).positions == [READY.tolist()]


def test_malformed_joints_are_refused() -> None:
    for bad in ([0.0] * 6, [np.nan] * 7):
        with pytest.raises(GeometryError, match="7 finite numbers"):
            brake(bad, [0.0] * 7, LIMITS)
        with pytest.raises(GeometryError, match="7 finite numbers"):
            joint_motion(ARM, bad, READY, LIMITS)
        with pytest.raises(GeometryError, match="7 finite numbers"):
            straight_motion(ARM, bad, ARM.forward(READY), LIMITS)


@pytest.mark.parametrize(
    ("name", "value"),
    [("joint_velocity", (1.0,) * 6), ("joint_jerk", (0.0,) * 7), ("linear_velocity", -1.0), ("linear_jerk", np.inf)],
)
def test_limits_that_are_none_are_refused(name: str, value: Any) -> None:
    with pytest.raises(ConfigurationError, match=name):
        dataclasses.replace(LIMITS, **{name: value})
