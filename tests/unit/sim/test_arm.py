from typing import Literal

import msgspec
import numpy as np
import pytest

from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.motion.press import RESISTANCE, TOLERANCE, PressMotion
from pcmrs.errors import DeviceError
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointTrajectory, PressRequest
from pcmrs.spatial import Transform, distance, rotation_angle
from pcmrs_sim.arm import Arm
from pcmrs_sim.settings import ArmSettings, GeometrySettings, SimSettings, SkinSettings
from tests.support.trials import run_counts
from tests.unit.sim.simulated_arms import FACTS, HOME, PERIOD, body_before_tool, make_arm, new_arm, smooth


@run_counts(2, nightly=10)
@pytest.mark.parametrize("phantom", ["head", "femur"])
def test_the_flange_ends_within_a_tenth_of_a_millimetre(phantom: Literal["head", "femur"], runs: int) -> None:
    for seed in range(runs):
        model, arm = ArmModel(FACTS), make_arm(SimSettings(seed=seed, phantom=phantom))
        goal = HOME + np.random.default_rng(seed).uniform(-0.5, 0.5, len(HOME))
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
    for arm in (new_arm(SimSettings(), ForceSettings()), make_arm()):
        arm.follow(smooth(HOME, HOME + 0.3))
        arm.step(1500)
        ends.append((*arm.positions, *arm.sensor.flange_force))
    assert ends[0] == ends[1]


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
    tool = true @ SimSettings().geometry.flange_from_tool_tip.transform
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


INWARD = -GeometrySettings().flange_from_tool_tip.transform.rotation[:, 2]
REQUEST = PressRequest(
    force=3.0,
    direction_in_flange=(float(INWARD[0]), float(INWARD[1]), float(INWARD[2])),
    travel=0.010,
    speed=0.02,
    timeout=8.0,
)


def pressed(
    gap: float, request: PressRequest = REQUEST, stiffness: float = 1000.0
) -> tuple[Arm, PressMotion, list[float]]:
    """The arm after a press on a head `gap` (m) away, and the true force at every millisecond."""
    settings = SimSettings(contact=SkinSettings(stiffness=stiffness))
    arm = make_arm(settings)
    arm.contact.place(body_before_tool(gap, settings))
    press = arm.press(request)
    forces = []
    for _ in range(9000):
        arm.step(1)
        forces.append(arm.contact.force)
        if arm.reference.ended and arm.at_rest:
            break
    return arm, press, forces


@pytest.mark.parametrize("stiffness", [600.0, pytest.param(1000.0, marks=pytest.mark.nightly), 5000.0])
@pytest.mark.parametrize("force", [1.0, pytest.param(3.0, marks=pytest.mark.nightly), 5.0])
def test_the_force_is_reached_without_overshoot_and_kept(force: float, stiffness: float) -> None:
    arm, press, forces = pressed(0.0, msgspec.structs.replace(REQUEST, force=force), stiffness)
    assert arm.stopped is None
    assert forces[-1] == pytest.approx(force, abs=TOLERANCE + 0.1)
    assert press.force == pytest.approx(forces[-1], abs=0.3)
    assert max(forces) < force + 2 * TOLERANCE
    arm.step(2000)
    assert arm.contact.force == pytest.approx(forces[-1], abs=0.15), "it stays"


def test_tool_moves_straight_along_its_axis_within_the_speed() -> None:
    arm = make_arm()
    arm.contact.place(body_before_tool(0.005))
    start = arm.base_from_flange()
    press = arm.press(msgspec.structs.replace(REQUEST, speed=0.003))
    ways = [0.0]
    for _ in range(300):
        arm.step(10)
        ways.append(press.travelled)
    assert np.diff(ways).max() <= 0.003 * 0.010 * (1 + 1e-9)
    way = start.inverse() @ arm.base_from_flange().translation
    assert np.linalg.norm(np.cross(way, INWARD)) < 1e-4
    assert rotation_angle(start, arm.base_from_flange()) < 2e-4
    assert way @ INWARD == pytest.approx(press.travelled, abs=1e-4)


def test_in_the_air_the_speed_is_that_of_the_admittance() -> None:
    arm = make_arm()
    arm.contact.place(body_before_tool(0.05))
    press = arm.press(REQUEST)
    arm.step(300)
    before = press.travelled
    arm.step(200)
    assert (press.travelled - before) / 0.2 == pytest.approx(REQUEST.force / RESISTANCE, rel=0.1)


def test_without_contact_it_ends_at_its_travel() -> None:
    arm, press, _ = pressed(0.05)
    assert arm.stopped == "no_contact"
    assert 0.0099 < press.travelled <= 0.0101


def test_contact_that_is_too_soft_ends_at_the_travel() -> None:
    arm, press, forces = pressed(0.002, stiffness=200.0)
    assert arm.stopped == "travel_limit"
    assert press.travelled <= 0.0101
    assert 0.5 < forces[-1] < 3.0


def test_it_does_not_press_for_ever() -> None:
    arm, _, _ = pressed(0.002, msgspec.structs.replace(REQUEST, timeout=0.5))
    assert arm.stopped == "timeout"
