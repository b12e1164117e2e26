"""What stands in the simulated scene is the phantom that the plan was made for."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from structlog.testing import capture_logs

from pcmrs.kinematics.arms import ARMS
from pcmrs.spatial import Floats
from pcmrs_sim import femur, head
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.plan import SITES_DEG, TRAJECTORIES, coil_pose, trajectory
from pcmrs_sim.plant import plant_model
from pcmrs_sim.settings import ArmSettings, GeometrySettings
from tests.unit.sim.simulated_arms import make_arm

ABOVE = 0.05  # m


def depth(phantom: Phantom, point: Floats, outwards: Floats) -> float:
    """How deep below a point of the image, m, a ray from `ABOVE` it meets the scene."""
    model = plant_model(ARMS["iiwa14"], ArmSettings(), GeometrySettings().flange_from_tool_tip.transform, phantom)
    data = mujoco.MjData(model)
    data.qpos[:] = ARMS["iiwa14"].home
    mujoco.mj_forward(model, data)
    world_from_image = phantom.world_from_image
    outwards = world_from_image.rotation @ (outwards / np.linalg.norm(outwards))
    start, hit = world_from_image @ point + ABOVE * outwards, np.zeros(1, dtype=np.int32)
    distance = float(mujoco.mj_ray(model, data, start, -outwards, None, 1, -1, hit))
    assert model.geom_bodyid[hit[0]] == 0, "nothing of the arm is in the way"
    return distance - ABOVE


@pytest.mark.parametrize("course", TRAJECTORIES)
def test_every_drill_meets_the_femur_at_its_entry(course: tuple[float, float, float]) -> None:
    entry, target = trajectory(*course)
    assert depth(femur.FEMUR, entry, entry - target) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("site", SITES_DEG)
def test_every_coil_meets_the_head(site: tuple[float, float]) -> None:
    pose = coil_pose(*site)
    # In the scene the head is an ellipsoid, which is a little rounder than the scalp.
    assert 0.0 <= depth(head.HEAD, pose.translation, pose.rotation[:, 2]) < 0.012


def test_an_unstable_simulation_is_logged_and_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    arm = make_arm()
    arm._data.qvel[:] = 1e30
    with capture_logs() as logged:
        arm.step(1)
    assert "unstable" in logged[0]["text"]
    assert list(tmp_path.iterdir()) == []
