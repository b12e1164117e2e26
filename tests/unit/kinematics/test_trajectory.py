""""""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import GeometryError, UnreachableError
from pcmrs.kinematics.trajectory import brake, concatenate, joint_motion, straight_motion
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Transform, distance
from tests.support.trials import examples, run_counts
from tests.unit.kinematics.motions import ARM, LIMITS, assert_within_joint_limits, derivative, seeds
from tests.unit.kinematics.reached_poses import READY

UNHURRIED_TOOL = dataclasses.replace(LIMITS, linear_velocity=100.0)


def flange_speed(trajectory: JointTrajectory) -> float:
    """The greatest, m/s."""
    places = [ARM.forward(q).translation for q in trajectory.positions]
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).max()) / trajectory.period


@run_counts(6, nightly=60)
def test_joint_motion_is_exact_at_its_ends_and_keeps_every_limit(runs: int) -> None:
    for seed in range(runs):
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
