"""Motion along an axis of the flange: straight, without turning, and never beyond its travel."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.motion._axis import AxisMotion
from pcmrs.spatial import Floats, rotation_angle
from tests.support.trials import examples
from tests.unit.devices.spring import HOME, MODEL

STEP = 1 / 200
AXIS = np.array((0.0, 0.0, 1.0))


class Steady(AxisMotion):
    """Moves at one speed, m/s, until it has gone for so long, s."""

    speed, lasts = 0.02, np.inf
    time = 0.0

    def _wanted(self) -> float:
        self.time += STEP
        self.ended = self.time > self.lasts
        return self.speed


def steady(axis: Floats = AXIS, travel: float = 0.05, start: Floats = HOME, velocity: float = 0.0) -> Steady:
    return Steady(MODEL, start, np.full(7, velocity), axis, travel, STEP)


@examples(10)
@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).filter(lambda axis: np.linalg.norm(axis) > 0.1))
def test_the_flange_goes_along_the_axis_and_does_not_turn(direction: list[float]) -> None:
    axis = np.array(direction) / np.linalg.norm(direction)
    motion, start = steady(axis), MODEL.forward(HOME)
    for _ in range(200):
        flange = MODEL.forward(motion.advance()[0])
    assert motion.travelled == pytest.approx(0.02 * 200 * STEP, rel=0.05)
    assert np.allclose((start.inverse() @ flange).translation, motion.travelled * axis, atol=2e-4)
    assert rotation_angle(start, flange) < 1e-3


def test_the_tool_slows_down_and_never_passes_its_travel() -> None:
    motion = steady(travel=0.01)
    travelled = []
    for _ in range(1000):
        motion.advance()
        travelled.append(motion.travelled)
    assert travelled == sorted(travelled)
    assert travelled[-1] == pytest.approx(0.01, abs=1e-6)
    assert max(travelled) <= 0.01


def test_an_earlier_motion_fades_out_without_a_jump() -> None:
    motion = steady(velocity=0.5)
    motion.speed = 0.0
    samples = np.array([motion.advance() for _ in range(100)])
    speeds = np.abs(samples[:, 1]).max(axis=1)
    assert speeds[0] == pytest.approx(0.5, rel=0.3)
    assert np.all(np.diff(speeds) < 0.0)
    assert speeds[-1] < 1e-6
    assert np.allclose(np.diff(samples[:, 0], axis=0) / STEP, samples[1:, 1])


def test_an_axis_that_leads_beyond_a_joint_limit_halts_the_arm() -> None:
    near_end = HOME.copy()
    near_end[3] = MODEL.upper[3] - 1e-3
    start = MODEL.forward(near_end)
    for sign in (1.0, -1.0):
        motion = steady(sign * AXIS, travel=0.1, start=near_end)
        while motion.halt is None and motion.travelled < 0.09:
            position = motion.advance()[0]
        if motion.halt is not None:
            break
    assert motion.halt == "joint_limit"
    assert position[3] >= MODEL.upper[3]
    assert (start.inverse() @ MODEL.forward(position)).translation[2] * sign >= 0.0


def test_a_motion_that_has_ended_stands_still() -> None:
    motion = steady()
    motion.lasts = 0.5
    while not motion.ended:
        last = motion.position
        motion.advance()
    assert np.array_equal(motion.advance(), (last, np.zeros(7), np.zeros(7)))
    assert not motion.velocity.any()
