from typing import Literal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.motion.force import ForceSettings
from pcmrs.errors import DeviceError
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointTrajectory
from pcmrs.spatial import Transform, distance
from pcmrs_sim.settings import ArmSettings, SimSettings
from tests.support.trials import examples
from tests.unit.sim.simulated_arms import FACTS, HOME, PERIOD, body_before_tool, make_arm, smooth


@examples(10)
@given(st.integers(0, 1000), st.sampled_from(["head", "femur"]), st.lists(st.floats(-0.5, 0.5), min_size=7, max_size=7))
def test_the_flange_ends_within_a_tenth_of_a_millimetre(
    seed: int, phantom: Literal["head", "femur"], change: list[float]
) -> None:
    model, arm = ArmModel(FACTS), make_arm(SimSettings(seed=seed, phantom=phantom))
    goal = HOME + change
    arm.follow(smooth(HOME, goal))
    arm.step(2000)
    overshoot = 0.0
    for _ in range(20):
        arm.step(100)
        overshoot = max(overshoot, distance(model.forward(arm.positions), model.forward(goal)))
    assert arm.at_rest
    assert distance(model.forward(arm.positions), model.forward(goal)) < 1e-4
    assert overshoot < 4e-4


def test_the_same_seed_gives_the_same_motion() -> None:
    ends = []
    for _ in range(2):
        arm = make_arm()
        arm.follow(smooth(HOME, HOME + 0.3))
        arm.step(1500)
        ends.append(arm.positions)
    assert np.array_equal(ends[0], ends[1])


def test_hold_brakes_within_the_acceleration_limit() -> None:
    arm = make_arm()
    arm.follow(smooth(HOME, HOME + 0.5))
    arm.step(1000)
    arm.hold()
    velocities = []
    while not arm.reference.ended:
        velocities.append(arm.reference.velocity)
        arm.step(1)
    assert np.abs(np.diff(velocities, axis=0)).max() / 0.001 < 1.05 * ArmSettings().brake_acceleration
    assert len(velocities) < 300
    arm.step(1000)
    assert arm.at_rest
    assert np.abs(arm.reference.position - HOME).max() < 0.5


def test_hold_at_rest_stays() -> None:
    arm = make_arm()
    arm.hold()
    arm.step(100)
    assert np.array_equal(arm.reference.position, HOME)


def test_start_within_tolerance_is_followed_without_a_jump() -> None:
    arm = make_arm()
    arm.follow(smooth(HOME + 0.01, HOME + 0.2))
    previous = arm.reference.position
    for _ in range(2000):
        arm.step(1)
        assert np.abs(arm.reference.position - previous).max() < 0.001
        previous = arm.reference.position
    assert np.allclose(previous, HOME + 0.2)


def test_a_single_posture_is_no_motion() -> None:
    arm = make_arm()
    arm.follow(JointTrajectory(period=PERIOD, positions=[HOME.tolist()]))
    assert arm.reference.ended


BEYOND = HOME.copy()
BEYOND[5] = 2.2
REFUSED = {
    "from the present posture": smooth(HOME + 0.03, HOME),
    "range": smooth(HOME, BEYOND, 20.0),
    "rad/s": smooth(HOME, HOME - 0.4, 0.3),
    "finite": JointTrajectory(period=PERIOD, positions=[HOME.tolist(), [float("nan")] * 7]),
    "7 joints": JointTrajectory(period=PERIOD, positions=[HOME.tolist(), [0.0] * 6]),
    "period": JointTrajectory(period=0.0, positions=[HOME.tolist()]),
    "0 postures": JointTrajectory(period=PERIOD, positions=[]),
}


@pytest.mark.parametrize("text", REFUSED)
def test_refused_trajectories_change_nothing(text: str) -> None:
    arm = make_arm()
    with pytest.raises(DeviceError, match=text):
        arm.follow(REFUSED[text])
    assert arm.reference.ended
    assert np.array_equal(arm.reference.position, HOME)


def test_true_flange_agrees_with_mujoco_and_differs_from_model() -> None:
    arm, model = make_arm(SimSettings(seed=4)), ArmModel(FACTS)
    true = arm.base_from_flange()
    tool = true @ SimSettings().geometry.flange_from_coil.transform
    assert np.allclose(arm._data.body("tool").xpos, tool.translation, atol=1e-6)
    assert 1e-4 < distance(true, model.forward(arm.positions)) < 3e-3
    exact = make_arm(SimSettings(arm=ArmSettings(geometry_error_mm=0.0)))
    assert distance(exact.base_from_flange(), model.forward(exact.positions)) < 1e-12


def test_the_force_limit_also_guards_a_standing_arm() -> None:
    arm, place = make_arm(force=ForceSettings(force_limit=10.0, relief_mm=5.0)), body_before_tool(0.0)
    for depth in np.linspace(0.0, 0.012, 200):
        arm.contact.place(Transform(place.rotation, place.translation + depth * place.rotation[:, 2]))
        arm.step(5)
    arm.step(1000)
    (alarm,) = arm.alarms
    assert alarm.fields["relieved"] == pytest.approx(0.005, abs=1e-4)
    assert arm.at_rest
    assert arm.contact.force < 8.0
