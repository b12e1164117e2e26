"""Motions of the head: drift, breathing, steps and bursts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.messages import HeadBurst, HeadMotion, HeadStep
from pcmrs.spatial import Floats
from pcmrs_sim.motion import STEP_TIME, head_offset

X, Z = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def course(motion: HeadMotion, seconds: float, period: float = 0.01) -> Floats:
    return np.array([head_offset(motion, time) for time in np.arange(0.0, seconds, period)])


def test_by_default_nothing_moves() -> None:
    assert not course(HeadMotion(), 10.0).any()


@given(st.integers(0, 2**32), st.floats(0.0, 1e4))
def test_motion_depends_on_seed_and_time_and_starts_at_the_head(seed: int, time: float) -> None:
    motion = HeadMotion(drift=(3e-5, 0.0, 0.0), breathing_amplitude=0.002, seed=seed)
    assert np.array_equal(head_offset(motion, time), head_offset(motion, time))
    assert np.allclose(head_offset(motion, 0.0), 0.0, atol=1e-15)


def test_drift_covers_its_way() -> None:
    motion = HeadMotion(drift=(0.06 / 1800, 0.0, 0.0))
    assert head_offset(motion, 1800.0) == pytest.approx([0.06, 0.0, 0.0])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_breathing_has_its_amplitude_and_frequency(seed: int) -> None:
    motion = HeadMotion(breathing_amplitude=0.002, breathing_hz=0.25, breathing_direction=Z, seed=seed)
    way = course(motion, 40.0)[:, 2]
    assert np.ptp(way) == pytest.approx(0.004, rel=1e-3)
    spectrum = np.abs(np.fft.rfft(way - way.mean()))
    assert np.fft.rfftfreq(len(way), 0.01)[spectrum.argmax()] == pytest.approx(0.25)


def test_a_step_is_quick_and_stays() -> None:
    motion = HeadMotion(steps=[HeadStep(time=1.0, offset=(0.005, 0.0, 0.0))])
    way = course(motion, 3.0)[:, 0]
    assert not way[:100].any()
    assert way[100 + round(STEP_TIME / 0.01) :] == pytest.approx(0.005)
    assert np.all(np.diff(way) >= 0.0)


def test_a_burst_has_its_speed_for_its_time() -> None:
    motion = HeadMotion(bursts=[HeadBurst(time=1.0, duration=0.5, speed=0.086, direction=X)])
    way = course(motion, 3.0, 0.001)[:, 0]
    speed = np.diff(way) / 0.001
    assert speed[1000:1499] == pytest.approx(0.086)
    assert np.abs(speed[:999]).max() < 1e-9
    assert np.abs(speed[1501:]).max() < 1e-9
    assert way[-1] == pytest.approx(0.043)
