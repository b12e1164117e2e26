"""What stands in the model of the cell is the phantom that the plan was made for, with the tool and its markers."""

from typing import Any

import mujoco
import numpy as np
import pytest

from pcmrs.devices.motion.force import ForceSettings
from pcmrs.spatial import Floats
from pcmrs_sim import femur, head
from pcmrs_sim.cell_model import OPAQUE, cell_model
from pcmrs_sim.markers import MARKER_BODIES, SPHERE_RADIUS
from pcmrs_sim.phantom import Phantom
from pcmrs_sim.phantoms import PHANTOMS, SURFACE_POINTS
from pcmrs_sim.plan import SITES_DEG, TRAJECTORIES, coil_pose, trajectory
from pcmrs_sim.settings import ArmSettings, SimSettings
from pcmrs_sim.world import World
from tests.unit.sim.simulated_arms import FACTS, HOME

ABOVE = 0.05  # m
MESH_ERROR = 2e-4
"""Largest distance of the mesh from the formula, m."""


def model_and_data(name: str) -> tuple[Any, Any]:
    settings = SimSettings(phantom=name)  # type: ignore[arg-type]
    model = cell_model(FACTS, settings, PHANTOMS[name])
    data = mujoco.MjData(model)
    data.qpos[:] = HOME
    place = PHANTOMS[name].world_from_image
    mocap = model.body("body").mocapid[0]
    data.mocap_pos[mocap], data.mocap_quat[mocap] = place.translation, place.quat_wxyz
    mujoco.mj_kinematics(model, data)
    return model, data


CELLS = {name: model_and_data(name) for name in PHANTOMS}


def depth(name: str, phantom: Phantom, point: Floats, outwards: Floats) -> float:
    """How deep below a point of the image, m, a ray from `ABOVE` it meets the scene."""
    model, data = CELLS[name]
    outwards = phantom.world_from_image.rotation @ (outwards / np.linalg.norm(outwards))
    start, hit = phantom.world_from_image @ point + ABOVE * outwards, np.zeros(1, dtype=np.int32)
    distance = float(mujoco.mj_ray(model, data, start, -outwards, None, 1, -1, hit, None))
    assert model.geom(hit[0]).name == "body", "nothing else is in between"
    return distance - ABOVE


@pytest.mark.parametrize("course", TRAJECTORIES)
def test_every_drill_meets_the_femur_at_its_entry(course: tuple[float, float, float]) -> None:
    entry, target = trajectory(*course)
    assert depth("femur", femur.FEMUR, entry, entry - target) == pytest.approx(0.0, abs=MESH_ERROR)


@pytest.mark.parametrize("site", SITES_DEG)
def test_every_coil_meets_the_head(site: tuple[float, float]) -> None:
    pose = coil_pose(*site)
    assert depth("head", head.HEAD, pose.translation, pose.rotation[:, 2]) == pytest.approx(0.0, abs=MESH_ERROR)


def test_the_mesh_is_the_surface_that_a_hand_can_touch() -> None:
    rng = np.random.default_rng(4)
    for _ in range(200):
        point = SURFACE_POINTS["head"](rng)
        assert abs(depth("head", head.HEAD, point, head.outward_normal(point))) < MESH_ERROR


@pytest.mark.parametrize("name", PHANTOMS)
def test_only_the_tool_has_mass_on_the_flange(name: str) -> None:
    """Markers, holder and patient change nothing of the dynamics."""
    model, _ = CELLS[name]
    phantom = PHANTOMS[name]
    assert model.body("tool").mass[0] == pytest.approx(sum(shape.mass for shape in phantom.tool))
    assert model.nv == len(FACTS.joints)


@pytest.mark.parametrize("name", PHANTOMS)
def test_nothing_stands_close_before_a_sphere(name: str) -> None:
    """Nor is a sphere inside a tool, a hand or the patient."""
    settings = SimSettings(phantom=name, arm=ArmSettings(physics="kinematic"))  # type: ignore[arg-type]
    cell = World(settings, FACTS, ForceSettings(), 0.0).observe()
    cell.refresh()
    groups = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
    groups[OPAQUE] = 1
    for body, markers in MARKER_BODIES.items():
        for number in range(len(markers.positions)):
            site = cell.data.site(f"{body}_{number}")
            normal = site.xmat.reshape(3, 3)[:, 2]
            start, hit = site.xpos + 0.08 * normal, np.zeros(1, dtype=np.int32)
            met = mujoco.mj_ray(cell.model, cell.data, start, -normal, groups, 1, -1, hit, None)
            assert not 0.0 <= met < 0.08 + SPHERE_RADIUS, (body, number)
