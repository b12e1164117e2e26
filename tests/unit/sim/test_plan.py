from pathlib import Path

import numpy as np
import pytest

from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.spatial import Floats, Transform
from pcmrs_sim import femur, head
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.phantoms import PHANTOMS
from pcmrs_sim.plan import TRAJECTORIES, main, make_plans, trajectory
from pcmrs_sim.settings import SimSettings
from tests import ROOT

EXAMPLES = ROOT / "examples"
STANDOFF = 0.070  # m along +z of the tool
POSES = {
    workflow: [Transform.from_quat_xyzw(pose["position"], pose["quat_xyzw"]) for pose in plan["poses"]]
    for workflow, plan in make_plans().items()
}
ALL = [
    pytest.param(PHANTOMS[phantom], pose, id=f"{phantom}-{number}")
    for phantom, workflow in (("head", "ratms"), ("femur", "femoroplasty"))
    for number, pose in enumerate(POSES[workflow], start=1)
]


def test_the_examples_are_what_the_command_writes(tmp_path: Path) -> None:
    main(tmp_path)
    written = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    assert set(written) == {"ratms_plan.json", "femoroplasty_plan.json", "head_phantom.ply", "femur_phantom.ply"}
    assert written == {name: (EXAMPLES / name).read_bytes() for name in written}


@pytest.mark.parametrize("workflow", POSES)
def test_twelve_poses_are_different(workflow: str) -> None:
    assert len({tuple(pose.translation) for pose in POSES[workflow]}) == 12


def test_coils_are_tangent_to_the_scalp() -> None:
    for pose in POSES["ratms"]:
        assert np.allclose(head.surface_point(pose.translation - head.CENTRE), pose.translation, atol=1e-8)
        assert np.allclose(pose.rotation[:, 2], head.outward_normal(pose.translation), atol=1e-7)


@pytest.mark.parametrize(("course", "pose"), list(zip(TRAJECTORIES, POSES["femoroplasty"], strict=True)))
def test_drills_enter_at_the_greater_trochanter_and_stay_in_bone(
    course: tuple[float, float, float], pose: Transform
) -> None:
    entry, target = trajectory(*course)
    assert np.allclose(pose.translation, entry, atol=1e-8)
    assert np.allclose(np.cross(pose.rotation[:, 2], entry - target), 0.0, atol=1e-8)
    assert np.dot(pose.rotation[:, 2], entry - target) > 0.0
    way = [femur.distance(entry + part * (target - entry)) for part in np.linspace(0.0, 1.0, 50)]
    assert way[0] == pytest.approx(0.0, abs=1e-9)
    assert max(way[1:]) < 0.0
    assert femur.distance(target) < -0.010  # the cement's place, well inside the neck
    assert np.linalg.norm(entry - femur.LANDMARKS[0].position) < 0.055


@pytest.mark.parametrize(("phantom", "pose"), ALL)
def test_every_pose_is_reachable_and_the_way_home_leads_away(phantom: Phantom, pose: Transform) -> None:
    settings = SimSettings()
    arm = ArmModel(ARMS["iiwa14"])
    home = np.array(arm.facts.home)
    world_from_image = phantom.world_from_image
    flange_from_tool = settings.geometry.flange_from_tool_tip.transform
    middle = world_from_image @ phantom.inside

    def posture(offset: float, seed: Floats) -> Floats:
        tool_from_offset = Transform.from_rotvec((0.0, 0.0, offset), (0.0, 0.0, 0.0))
        return inverse(arm, world_from_image @ pose @ tool_from_offset @ flange_from_tool.inverse(), seed)

    standoff = posture(STANDOFF, home)
    target = posture(0.0, standoff)
    assert np.abs(target - standoff).max() < 0.35  # no other branch
    way = [standoff + (home - standoff) * part for part in np.linspace(0.0, 1.0, 101)]
    distances = [np.linalg.norm((arm.forward(q) @ flange_from_tool).translation - middle) for q in way]
    assert np.diff(distances).min() > -1e-5
    assert distances[-1] > 0.5


CLEAR = 0.28  # m from the middle of the body, from where on a way may also come nearer

every_arm = pytest.mark.parametrize("name", ["panda", "ur5"])


@every_arm
@pytest.mark.parametrize(("body", "workflow"), [("head", "ratms"), ("femur", "femoroplasty")])
def test_example_poses_are_reachable_and_the_way_home_leads_away(name: str, body: str, workflow: str) -> None:
    arm, phantom = ArmModel(find_arm(name)), PHANTOMS[body]
    home = np.array(arm.facts.home)
    for plan in make_plans()[workflow]["poses"]:
        pose = Transform.from_quat_xyzw(plan["position"], plan["quat_xyzw"])
        standoff = posture(arm, phantom, pose, STANDOFF, home)
        assert np.abs(posture(arm, phantom, pose, 0.0, standoff) - standoff).max() < 0.35  # no other branch
        ways = standoff + np.linspace(0.0, 1.0, 101)[:, None] * (home - standoff)
        distances = np.array([distance_from_middle(arm, phantom, q) for q in ways])
        assert np.diff(distances)[distances[:-1] < CLEAR].min() > 0.0
        assert distances[-1] > 0.5


def posture(arm: ArmModel, phantom: Phantom, pose: Transform, offset: float, seed: Floats) -> Floats:
    flange_from_tool = SimSettings().geometry.flange_from_tool_tip.transform
    tool_from_offset = Transform.from_rotvec((0.0, 0.0, offset), (0.0, 0.0, 0.0))
    return inverse(arm, phantom.world_from_image @ pose @ tool_from_offset @ flange_from_tool.inverse(), seed)


def distance_from_middle(arm: ArmModel, phantom: Phantom, q: Floats) -> float:
    tool = arm.forward(q) @ SimSettings().geometry.flange_from_tool_tip.transform
    return float(np.linalg.norm(tool.translation - phantom.world_from_image @ phantom.inside))
