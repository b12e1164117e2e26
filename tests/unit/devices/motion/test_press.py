"""Presses and reliefs at a spring."""

import dataclasses

import numpy as np
import pytest

from pcmrs.devices.motion.follower import Follower
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.motion.press import RESISTANCE
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import PressRequest
from tests.unit.devices.spring import HOME, LIMITS, MODEL, STEPS, Spring, follower, run


@STEPS
def test_a_press_reaches_its_force(step: float) -> None:
    sensor = Spring(gap=0.002)
    arm = follower(step, sensor)
    press = arm.press(
        PressRequest(force=3.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.010, speed=0.02, timeout=8.0)
    )
    samples = run(arm, sensor, step, 10.0)
    assert arm.stopped is None
    assert press.force == pytest.approx(3.0, abs=0.3)
    speeds = np.array([np.linalg.norm(MODEL.jacobian(q)[:3] @ v) for q, v, _ in samples])
    assert speeds.max() <= 3.0 / RESISTANCE * 1.05


@STEPS
def test_excessive_force_is_relieved_and_reported(step: float) -> None:
    sensor = Spring(gap=-0.03)  # 30 N at once
    sensor.look(HOME)
    arm = follower(step, sensor, force_limit=20.0, relief_mm=2.0)
    samples = run(arm, sensor, step, 5.0)
    (alarm,) = arm.alarms
    assert (alarm.code, alarm.danger) == ("force_limit", True)
    way = MODEL.forward(HOME).inverse() @ MODEL.forward(samples[-1, 0]).translation
    assert np.allclose(way, (0.0, 0.0, -0.002), atol=1e-4)


@STEPS
def test_a_press_that_leads_out_of_a_joints_range_is_held(step: float) -> None:
    free, sensor = follower(step), Spring(1.0)
    request = PressRequest(force=3.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.010, speed=0.02, timeout=8.0)
    free.press(request)
    way = run(free, sensor, step, 10.0)[-1, 0] - HOME
    joint = int(np.abs(way).argmax())
    half = float(HOME[joint] + way[joint] / 2)
    joints = list(MODEL.facts.joints)
    rising, facts = bool(way[joint] > 0.0), joints[joint]
    joints[joint] = dataclasses.replace(
        facts, lower=facts.lower if rising else half, upper=half if rising else facts.upper
    )
    model = ArmModel(dataclasses.replace(MODEL.facts, joints=tuple(joints)))
    arm = Follower(model, LIMITS, ForceSettings(), sensor, HOME, step)
    arm.press(request)
    samples = run(arm, sensor, step, 10.0)
    assert arm.stopped == "joint_limit"
    beyond = np.sign(way[joint]) * (samples[:, 0, joint] - half)
    assert 0.0 <= beyond.max() < 1e-3, "it brakes at once"


@STEPS
def test_successive_forces_are_relieved_by_one_relief_distance(step: float) -> None:
    sensor = Spring(gap=1.0)
    arm = follower(step, sensor, force_limit=10.0, relief_mm=2.0)
    arm.press(PressRequest(force=3.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.010, speed=0.02, timeout=8.0))
    arm.hold()
    held = arm.reference.position.copy()
    for gap in (-0.015, -0.030, -0.045):  # the body comes nearer and nearer, and nobody presses Stop
        for _ in range(round(1.0 / step)):
            sensor.move_to(gap, arm.advance()[0])
    way = MODEL.forward(held).inverse() @ MODEL.forward(arm.reference.position).translation
    assert len(arm.alarms) == 3
    assert way[2] == pytest.approx(-0.002, abs=1e-4)
