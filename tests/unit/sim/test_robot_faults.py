"""A moving arm that deviates from its commanded posture is held; others are not."""

import numpy as np
import pytest

from pcmrs.devices.motion.force import ForceSettings
from pcmrs_sim.head import HEAD
from pcmrs_sim.kinematic_arm import KinematicArm
from pcmrs_sim.robot_faults import LARGEST_DEVIATION, hold_if_deviating
from pcmrs_sim.settings import SimSettings
from tests.unit.sim.simulated_arms import FACTS, HOME, smooth


@pytest.fixture
def arm() -> KinematicArm:
    return KinematicArm(FACTS, SimSettings(), ForceSettings(), HEAD)


def deviate(arm: KinematicArm, joint: int, angle: float) -> None:
    arm.disturbance.offset = np.where(np.arange(7) == joint, angle, 0.0)


def follow(arm: KinematicArm) -> None:
    """Let the arm move, checked as in the cell."""
    for _ in range(50):
        arm.step(10)
        hold_if_deviating(arm)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("joint", [0, 6])
def test_a_deviation_in_motion_brakes_with_one_alarm(arm: KinematicArm, joint: int, sign: float) -> None:
    arm.follow(smooth(HOME, HOME + 0.3))
    deviate(arm, joint, sign * (LARGEST_DEVIATION + 0.01))
    follow(arm)
    assert arm.stopped == "pose_differs"
    (alarm,) = arm.alarms
    assert (alarm.device, alarm.code, alarm.danger) == ("robot", "pose_differs", True)
    assert f"limit {LARGEST_DEVIATION:g}" in alarm.text


def test_a_deviation_within_the_limit_is_no_alarm(arm: KinematicArm) -> None:
    arm.follow(smooth(HOME, HOME + 0.3))
    deviate(arm, 2, 0.9 * LARGEST_DEVIATION)
    follow(arm)
    assert arm.stopped is None
    assert not arm.alarms


def test_an_arm_at_rest_is_not_held(arm: KinematicArm) -> None:
    deviate(arm, 2, 0.1)
    follow(arm)
    assert arm.stopped is None
    assert not arm.alarms
