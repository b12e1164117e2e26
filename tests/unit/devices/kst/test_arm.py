""""""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.kst._arm import LAG, MeasuredArm, TorqueForce
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats
from tests.unit.devices.kst_peer import MODEL, START, torques_of

HOME = np.array(ARMS["iiwa14"].home)

STEP = 0.005


def streamed(speed: float, until: float) -> MeasuredArm:
    """An arm that stood at home and was told, from 0 s on, to go at `speed`, rad/s."""
    arm = MeasuredArm(ArmModel(ARMS["iiwa14"]), np.array([0.0, 0.0, -1.0]), STEP)
    arm.take_joints(HOME, 0.0)
    arm.begin()
    for time in np.arange(STEP, until + STEP / 2, STEP):
        arm.add_set_point(told_at(speed, time), time)
    return arm


def told_at(speed: float, time: float) -> Floats:
    return HOME + speed * time


def test_an_answer_may_be_as_old_as_its_question() -> None:
    arm = streamed(speed=1.0, until=0.6)
    arm.take_joints(told_at(1.0, 0.1), captured=0.1)
    assert arm.deviation < 1e-9


def test_an_arm_that_lags_more_than_it_may_deviates() -> None:
    arm = streamed(speed=1.0, until=0.6)
    arm.take_joints(told_at(1.0, 0.6 - LAG), captured=0.6)
    assert arm.deviation < STEP + 1e-9
    arm = streamed(speed=1.0, until=0.6)
    arm.take_joints(told_at(1.0, 0.3 - LAG), captured=0.6)
    assert arm.deviation == pytest.approx(0.3, abs=2 * STEP)


def test_delayed_stream_does_not_put_an_arm_farther_behind() -> None:
    arm = streamed(speed=1.0, until=0.6)
    arm.add_set_point(told_at(1.0, 0.6 + STEP), 1.6)
    arm.take_joints(told_at(1.0, 0.5), captured=1.7)
    assert arm.deviation < 1e-9


def test_an_arm_beside_its_way_deviates_however_slow_the_answer() -> None:
    arm = streamed(speed=0.0, until=0.6)
    arm.take_joints(HOME + 0.03, captured=0.01)
    assert arm.deviation == pytest.approx(0.03)


@given(st.lists(st.floats(-0.8, 0.8), min_size=7, max_size=7), st.lists(st.floats(-30.0, 30.0), min_size=3, max_size=3))
def test_the_force_is_that_which_the_joints_feel(offsets: list[float], force: list[float]) -> None:
    posture = np.clip(START + offsets, MODEL.lower, MODEL.upper)
    sensor = TorqueForce(MODEL, np.array((0.0, 0.0, -1.0)))
    sensor.update(posture, torques_of(np.array(force), posture))
    weakest = float(np.linalg.svd(MODEL.jacobian(posture), compute_uv=False)[-1])
    error = float(np.linalg.norm(np.subtract(sensor.flange_force, force)))
    assert error <= np.linalg.norm(force) * 1.01e-4 / (1e-4 + weakest**2) * 2 + 1e-9
    assert sensor.magnitude == pytest.approx(float(np.linalg.norm(sensor.flange_force)))
