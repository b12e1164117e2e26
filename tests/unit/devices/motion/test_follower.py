"""An arm that is held brakes within its limits, and gives way only to a force that is too great."""

import numpy as np
import pytest

from pcmrs.messages import JointTrajectory, PressRequest
from tests.unit.devices.spring import ACCELERATION, HOME, JERK, MODEL, STEPS, Spring, follower, run


@STEPS
@pytest.mark.parametrize("again", [False, True])
def test_a_held_motion_brakes_as_fast_as_the_limits_allow(step: float, again: bool) -> None:
    arm = follower(step)
    arm.follow(JointTrajectory(period=1.0, positions=[HOME.tolist(), (HOME + 0.3).tolist(), (HOME + 0.6).tolist()]))
    speed = float([arm.advance() for _ in range(round(1.0 / step))][-1][1].max())
    samples = np.array([arm.reference.advance()])
    arm.hold()
    while not arm.reference.ended:
        samples = np.concatenate((samples, arm.advance()[None]))
        if again:
            arm.hold()
    assert arm.stopped == "held"
    assert np.all(samples[1:, 1] <= samples[:-1, 1] + 1e-9), "never faster"
    assert len(samples) * step == pytest.approx(speed / ACCELERATION + ACCELERATION / JERK, abs=2.1 * 0.005)


@STEPS
@pytest.mark.parametrize("relief_mm", [0.0, 2.0])
def test_held_arm_in_contact_moves_only_to_relieve_excess_force(step: float, relief_mm: float) -> None:
    sensor = Spring(gap=0.002)
    arm = follower(step, sensor, force_limit=10.0, relief_mm=relief_mm)
    arm.press(PressRequest(force=3.0, direction_in_flange=(0.0, 0.0, 1.0), travel=0.010, speed=0.02, timeout=8.0))
    while sensor.magnitude < 2.0:
        sensor.look(arm.advance()[0])
    arm.hold()
    run(arm, sensor, step, 1.0)
    held = arm.reference.position.copy()
    assert arm.reference.ended
    for _ in range(3):  # nothing draws it after a force that is less, or greater, than it was
        for gap in (0.010, 0.002, -0.003):
            sensor.move_to(gap, held)
            assert np.array_equal(arm.advance()[0], held)
    for gap in (-0.012, -0.022, -0.032):  # the body comes nearer and nearer
        for _ in range(round(1.0 / step)):
            sensor.move_to(gap, arm.advance()[0])
            arm.hold()  # Stop, pressed again and again
    way = MODEL.forward(held).inverse() @ MODEL.forward(arm.reference.position).translation
    assert -relief_mm * 1e-3 - 1e-4 <= way[2] <= 0.0
    assert np.linalg.norm(way[:2]) < 1e-4
