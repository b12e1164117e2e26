from pathlib import Path

import msgspec
import numpy as np
import pytest

from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform
from sim.phantom import CENTRE, outward_normal, surface_point
from sim.plan import main, make_plan
from sim.settings import SimSettings

EXAMPLE = Path(__file__).parents[2] / "examples" / "ratms_plan.json"
STANDOFF = 0.070  # m along +z of the coil
POSES = [Transform.from_quat_xyzw(pose["position"], pose["quat_xyzw"]) for pose in make_plan()["poses"]]


def test_the_example_is_what_the_command_writes(tmp_path: Path) -> None:
    main(tmp_path / "plan.json")
    assert (tmp_path / "plan.json").read_bytes() == EXAMPLE.read_bytes()
    assert msgspec.json.decode(EXAMPLE.read_bytes()) == make_plan()


def test_twelve_different_poses_are_tangent_to_the_scalp() -> None:
    assert len({tuple(pose.translation) for pose in POSES}) == 12
    for pose in POSES:
        assert np.allclose(surface_point(pose.translation - CENTRE), pose.translation, atol=1e-8)
        assert np.allclose(pose.rotation[:, 2], outward_normal(pose.translation), atol=1e-7)


@pytest.mark.parametrize("pose", POSES, ids=range(1, 13))
def test_every_pose_is_reachable_and_the_way_home_only_leads_away(pose: Transform) -> None:
    settings = SimSettings()
    arm = ArmModel(ARMS["iiwa14"])
    home = np.array(settings.arm.home)
    world_from_image = settings.geometry.world_from_image.transform
    flange_from_coil = settings.geometry.flange_from_coil.transform
    head = world_from_image @ CENTRE

    def posture(offset: float, seed: Floats) -> Floats:
        coil_from_offset = Transform.from_rotvec((0.0, 0.0, offset), (0.0, 0.0, 0.0))
        return inverse(arm, world_from_image @ pose @ coil_from_offset @ flange_from_coil.inverse(), seed)

    standoff = posture(STANDOFF, home)
    target = posture(0.0, standoff)
    assert np.abs(target - standoff).max() < 0.35  # no other branch
    way = [standoff + (home - standoff) * part for part in np.linspace(0.0, 1.0, 101)]
    distances = [np.linalg.norm((arm.forward(q) @ flange_from_coil).translation - head) for q in way]
    assert np.diff(distances).min() > -1e-5
    assert distances[-1] > 0.5
