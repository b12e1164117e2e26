"""The arm without dynamics: exactly on its reference, with the true flange and a spring as contact."""

import numpy as np
import pytest

from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Transform, distance
from pcmrs_sim.head import HEAD, surface_point
from pcmrs_sim.kinematic_arm import KinematicArm
from pcmrs_sim.settings import ArmSettings, SimSettings
from tests.unit.sim.simulated_arms import FACTS, HOME, body_before_tool, smooth


def kinematic(settings: SimSettings | None = None, force: ForceSettings | None = None) -> KinematicArm:
    return KinematicArm(FACTS, settings or SimSettings(), force or ForceSettings(), HEAD)


def test_the_arm_is_on_its_reference_and_ends_at_the_goal() -> None:
    arm = kinematic()
    arm.follow(smooth(HOME, HOME + 0.2))
    for _ in range(200):
        arm.step(10)
        assert np.array_equal(arm.positions, arm.reference.position)
    arm.step(100)
    assert arm.at_rest
    assert arm.positions == pytest.approx(HOME + 0.2, abs=1e-12)
    assert arm.velocities == pytest.approx(np.zeros(7), abs=1e-12)
    assert not arm.torques.any()


def test_steps_at_once_or_one_by_one_lead_to_the_same_posture() -> None:
    together, single = kinematic(), kinematic()
    for arm in (together, single):
        arm.follow(smooth(HOME, HOME + 0.2))
    together.step(730)
    for _ in range(730):
        single.step(1)
    assert np.array_equal(together.positions, single.positions)


def test_the_flange_is_where_the_arm_was_built_and_not_nominal() -> None:
    model = ArmModel(FACTS)
    built = kinematic(SimSettings(seed=4)).base_from_flange()
    assert 1e-4 < distance(built, model.forward(HOME)) < 3e-3
    exact = kinematic(SimSettings(arm=ArmSettings(geometry_error_mm=0.0)))
    assert distance(exact.base_from_flange(), model.forward(HOME)) < 1e-12


def test_a_standing_arm_returns_the_same_flange() -> None:
    arm = kinematic()
    flange = arm.base_from_flange()
    arm.step(100)
    assert arm.base_from_flange() is flange
    arm.follow(smooth(HOME, HOME + 0.1))
    arm.step(500)
    assert arm.base_from_flange() is not flange


@pytest.mark.parametrize("depth", [0.001, 0.004])
def test_the_force_is_stiffness_times_depth(depth: float) -> None:
    settings = SimSettings()
    arm = kinematic(settings)
    tool = arm.base_from_flange() @ settings.geometry.flange_from_tool_tip.transform
    arm.contact.place(tool @ Transform(np.eye(3), np.array([0.0, 0.0, depth]) - surface_point((0.0, 0.0, 1.0))))
    arm.step(10)
    assert arm.contact.force == pytest.approx(settings.contact.stiffness * depth, rel=1e-6)
    assert arm.sensor.magnitude == pytest.approx(arm.contact.force)
    arm.contact.place(body_before_tool(0.05))
    arm.step(10)
    assert arm.contact.force == 0.0


def test_too_much_force_stops_the_arm_within_the_relief() -> None:
    """The body comes against the standing tool."""
    arm, place = kinematic(force=ForceSettings(force_limit=10.0, relief_mm=5.0)), body_before_tool(0.0)
    for depth in np.linspace(0.0, 0.012, 60):
        arm.contact.place(Transform(place.rotation, place.translation + depth * place.rotation[:, 2]))
        arm.step(20)
    arm.step(1000)
    (alarm,) = arm.alarms
    assert alarm.code == "force_limit"
    assert alarm.fields["relieved"] == pytest.approx(0.005, abs=1e-4)
    assert arm.contact.force < 10.0
