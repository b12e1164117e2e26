"""Motions whose speed limit depends on the place, and the spline along which they go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import interpolate

from pcmrs.kinematics.arms import IIWA14_R820
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.time_parameterization import (
    CubicSpline,
    ProgressLimits,
    joint_request,
    solve,
    time_parameterize,
)
from pcmrs.kinematics.trajectory import joint_motion, straight_motion
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Floats, Transform, distance
from tests.support.trials import run_counts

ARM = ArmModel(IIWA14_R820)

READY = np.array((0.1, 0.5, 0.2, -1.2, 0.3, 0.9, 0.1))

LIMITS = MotionLimits(
    joint_velocity=(0.8,) * 7,
    joint_acceleration=(2.5,) * 7,
    joint_jerk=(15.0,) * 7,
    linear_velocity=0.2,
    linear_acceleration=0.5,
    linear_jerk=3.0,
    angular_velocity=0.6,
    angular_acceleration=1.5,
)

TOOL = Transform.from_rotvec((0.0, 0.02, 0.15), (0.0, 3.0, 0.0))

BODY, NEAR, SLOW = np.array((0.5, 0.0, 0.3)), 0.35, 0.05
"""Middle of a ball, m; how near to it the tool must be slow, m; and how slow, m/s."""

seeds = st.integers(0, 2**32 - 1)


def near(q: Floats) -> bool:
    return bool(np.linalg.norm((ARM.forward(q) @ TOOL).translation - BODY) < NEAR)


def slower_near_the_ball(postures: Floats) -> Floats:
    return np.array([SLOW if near(q) else 1.0 for q in postures])


def derivatives(trajectory: JointTrajectory) -> list[float]:
    """The greatest first, second and third derivative of any joint, by differences; at rest before and after."""
    padded = np.pad(np.array(trajectory.positions), ((3, 3), (0, 0)), mode="edge")
    return [float(np.abs(np.diff(padded, n, axis=0)).max()) / trajectory.period**n for n in (1, 2, 3)]


def fastest(trajectory: JointTrajectory, where: Callable[[Floats], bool]) -> float:
    """Of flange and tool point between two samples for which `where` holds, m/s."""
    postures = np.array(trajectory.positions)
    holds = np.array([where(q) for q in postures])
    flanges = [ARM.forward(q) for q in postures]
    points = np.array([(flange.translation, flange @ TOOL.translation) for flange in flanges])
    ways = np.linalg.norm(np.diff(points, axis=0), axis=2).max(axis=1)
    return float(ways[holds[1:] & holds[:-1]].max(initial=0.0)) / trajectory.period


def assert_keeps_everything(trajectory: JointTrajectory) -> None:
    velocity, acceleration, jerk = derivatives(trajectory)
    assert velocity <= 0.8 * (1 + 1e-6)
    assert acceleration <= 2.5 * (1 + 1e-6)
    assert jerk <= 15.0 * (1 + 1e-6)
    assert fastest(trajectory, lambda _: True) <= 0.2 * 1.001
    assert fastest(trajectory, near) <= SLOW * 1.001


@run_counts(5, nightly=50)
def test_joint_motion_is_slow_near_the_body_and_keeps_limits(runs: int) -> None:
    for seed in range(runs):
        start, goal = np.random.default_rng(seed).uniform(0.5 * ARM.lower, 0.5 * ARM.upper, (2, 7))
        trajectory = joint_motion(ARM, start, goal, LIMITS, flange_from_tool=TOOL, speed_limit_at=slower_near_the_ball)
        assert_keeps_everything(trajectory)
        positions = np.array(trajectory.positions)
        np.testing.assert_array_equal(positions[[0, -1]], (start, goal))
        along = (positions - start) @ (goal - start) / np.sum((goal - start) ** 2)
        np.testing.assert_allclose(positions, start + along[:, None] * (goal - start), atol=1e-9)
        assert np.all(np.diff(along) >= -1e-9), "it never goes back"


@run_counts(5, nightly=50)
def test_straight_line_is_slow_near_the_body_and_keeps_limits(runs: int) -> None:
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        begin = ARM.forward(READY) @ TOOL
        goal = Transform.from_rotvec(rng.uniform(-0.1, 0.1, 3), np.zeros(3)) @ begin
        goal = Transform(begin.rotation, begin.translation + goal.translation - begin.translation)
        trajectory = straight_motion(
            ARM, READY, goal @ TOOL.inverse(), LIMITS, flange_from_tool=TOOL, speed_limit_at=slower_near_the_ball
        )
        assert_keeps_everything(trajectory)
        tools = [ARM.forward(q) @ TOOL for q in trajectory.positions]
        assert distance(tools[-1], goal) < 1e-9
        for pose in tools:
            assert distance(begin, pose) + distance(pose, goal) == pytest.approx(distance(begin, goal), abs=1e-9)


def test_only_what_is_near_takes_longer() -> None:
    goal = READY + 0.8 * np.eye(7)[0]
    free = joint_motion(ARM, READY, goal, LIMITS, flange_from_tool=TOOL)
    same = joint_motion(ARM, READY, goal, LIMITS, flange_from_tool=TOOL, speed_limit_at=lambda q: np.full(len(q), 1.0))
    slow = joint_motion(ARM, READY, goal, LIMITS, flange_from_tool=TOOL, speed_limit_at=lambda q: np.full(len(q), 0.05))
    assert same == free
    assert fastest(slow, lambda _: True) == pytest.approx(0.05, rel=0.01)
    half = joint_motion(
        ARM, READY, goal, LIMITS, flange_from_tool=TOOL, speed_limit_at=lambda q: np.where(q[:, 0] > 0.5, 0.05, 1.0)
    )
    assert len(free.positions) < len(half.positions) < len(slow.positions)
    assert fastest(half, lambda q: q[0] < 0.4) == pytest.approx(0.2, rel=0.02)
    assert fastest(half, lambda q: q[0] > 0.5) == pytest.approx(0.05, rel=0.02)


@run_counts(30, nightly=300)
def test_progress_keeps_its_bounds_through_any_sections(runs: int) -> None:
    """Also through sections so short that nothing can be reached within them."""
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        places = np.unique(np.concatenate(((0.0, 1.0), rng.uniform(0.0, 1.0, rng.integers(1, 30)))))
        allowed = rng.choice((0.02, 0.1, 0.5), len(places))
        ways = np.diff(places) * rng.uniform(0.2, 1.0)
        bounds = ProgressLimits(*rng.uniform((0.2, 0.3, 1.0), (3.0, 5.0, 60.0)).tolist())
        progress = time_parameterize(places, ways, allowed, bounds)
        period = progress.duration / 4000
        parts = progress.at(np.linspace(0.0, progress.duration, 4001))
        assert parts[0] == 0.0
        assert parts[-1] == pytest.approx(1.0, abs=1e-9)
        speeds = np.diff(parts) / period
        assert speeds.min() >= -1e-7
        limit = np.minimum(bounds.velocity, np.minimum(allowed[1:], allowed[:-1]) / (ways / np.diff(places)))
        middle = np.clip(np.searchsorted(places, 0.5 * (parts[1:] + parts[:-1])) - 1, 0, len(limit) - 1)
        inside = np.searchsorted(places, parts[1:]) == np.searchsorted(places, parts[:-1])
        assert np.all(speeds[inside] <= limit[middle][inside] * (1 + 1e-4) + 1e-7)
        assert np.abs(np.diff(parts, 2)).max() / period**2 <= bounds.acceleration * (1 + 1e-3)


@st.composite
def rows_at_places(draw: st.DrawFn, fewest: int) -> tuple[Floats, Floats]:
    steps = np.array(draw(st.lists(st.floats(0.1, 3.0), min_size=fewest - 1, max_size=12)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    return np.concatenate(((0.0,), np.cumsum(steps))), rng.normal(size=(len(steps) + 1, 3))


@given(rows_at_places(4), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=9))
def test_without_slopes_at_its_ends_it_is_that_of_scipy(given: tuple[Floats, Floats], shares: list[float]) -> None:
    places, rows = given
    spline, expected = CubicSpline(places, rows), interpolate.CubicSpline(places, rows)
    at = places[-1] * np.array(shares)
    for order in range(3):
        np.testing.assert_allclose(spline(at, order), expected(at, order), rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(spline(places), rows, atol=1e-12)


@given(rows_at_places(2), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=9))
def test_with_slopes_at_its_ends_it_is_that_of_scipy(given: tuple[Floats, Floats], shares: list[float]) -> None:
    places, rows = given
    begin, end = np.array((1.0, -2.0, 0.5)), np.zeros(3)
    expected = interpolate.CubicSpline(places, rows, bc_type=((1, begin), (1, end)))
    spline = CubicSpline(places, rows, (begin, end))
    at = places[-1] * np.array(shares)
    for order in range(3):
        np.testing.assert_allclose(spline(at, order), expected(at, order), rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(spline(places[[0, -1]], 1), (begin, end), atol=1e-12)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_cubic_is_its_own_spline(order: int) -> None:
    places = np.array((0.0, 0.3, 1.0, 1.1, 2.0, 2.5))
    cubic = np.polynomial.Polynomial((0.4, -1.0, 0.7, 2.0))
    at = np.linspace(0.0, 2.5, 41)
    spline = CubicSpline(places, cubic(places)[:, None])
    np.testing.assert_allclose(spline(at, order)[:, 0], cubic.deriv(order)(at), atol=1e-9)


@pytest.mark.parametrize("joint", range(7))
def test_acceleration_may_be_greatest_for_an_instant(joint: int) -> None:
    """A distance of 2 a^3 / j^2: Ruckig alone finds no profile for about every second of them."""
    acceleration, jerk = 3.0, 30.0
    limits = replace(LIMITS, joint_acceleration=(acceleration,) * 7, joint_jerk=(jerk,) * 7)
    for start in np.linspace(-1.5, 1.5, 31):
        request = joint_request(np.full(7, 2.0), limits)
        positions = np.zeros(7)
        positions[joint] = start
        request.current_position = positions.tolist()
        positions[joint] += 2.0 * acceleration**3 / jerk**2
        request.target_position = positions.tolist()
        assert solve(request).duration == pytest.approx(4.0 * acceleration / jerk, rel=1e-4)
