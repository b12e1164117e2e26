"""Positions from the model's sensors, and what the tracker sees, against geometry computed in other ways."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Floats, Transform, distance, rotation_angle
from pcmrs_sim import head
from pcmrs_sim.cell_state import CellState
from pcmrs_sim.error_models import FEWEST_SPHERES, displaced
from pcmrs_sim.head import HEAD
from pcmrs_sim.markers import MARKER_BODIES
from pcmrs_sim.settings import ArmSettings, SimSettings
from pcmrs_sim.shape import Capsule, rotation_with_z
from tests.unit.sim.simulated_arms import FACTS, HOME

SETTINGS = SimSettings(arm=ArmSettings(geometry_error_mm=0.0))
GEOMETRY = SETTINGS.geometry
WORLD_FROM_TRACKER = GEOMETRY.world_from_tracker.transform
EYE = WORLD_FROM_TRACKER.translation
MODEL = ArmModel(FACTS)
FAR = Transform(np.eye(3), np.array((0.0, 2.0, 0.0)))


@pytest.fixture(scope="module")
def shared() -> CellState:
    return CellState(FACTS, SETTINGS, HEAD)


@pytest.fixture
def cell(shared: CellState) -> CellState:
    """A cell with the arm at home, the head in its place, and without pointer."""
    shared.move_joints(HOME)
    shared.place("body", HEAD.world_from_image)
    shared.place("pointer", FAR)
    shared.fix("body_ref", HEAD.body_ref_from_image.inverse())
    return shared


def facing_tracker(position: Floats) -> Transform:
    """A pose of the pointer whose markers face the tracker."""
    towards = Transform(rotation_with_z(EYE - position), position)
    return towards @ Transform(MARKER_BODIES["pointer"].plane.rotation, np.zeros(3)).inverse()


def spheres(name: str, world_from_body: Transform) -> Floats:
    return world_from_body @ MARKER_BODIES[name].positions


def test_sensors_agree_with_the_chain_of_all_frames(cell: CellState) -> None:
    rng = np.random.default_rng(2)
    tip_from_marker = GEOMETRY.tool_marker_from_tool_tip.transform.inverse()
    for _ in range(20):
        posture = rng.uniform(MODEL.lower, MODEL.upper)
        patient = Transform.from_rotvec(rng.normal(size=3), rng.normal(size=3))
        cell.move_joints(posture)
        cell.place("body", patient)
        flange = MODEL.forward(posture)
        tool_tip = flange @ GEOMETRY.flange_from_tool_tip.transform
        expected = {
            "world_from_flange": flange,
            "world_from_tool_tip": tool_tip,
            "tracker_from_coil": WORLD_FROM_TRACKER.inverse() @ tool_tip @ tip_from_marker,
            "tracker_from_body_ref": WORLD_FROM_TRACKER.inverse() @ patient @ HEAD.body_ref_from_image.inverse(),
        }
        for name, pose in expected.items():
            assert distance(cell.pose(name), pose) < 1e-12, name
            assert rotation_angle(cell.pose(name), pose) < 1e-9, name


@pytest.mark.parametrize("seed", [1, 4])
def test_the_arm_stands_as_it_was_built_for_its_seed(seed: int) -> None:
    built = ArmModel(displaced(FACTS, 1e-3, seed))
    cell = CellState(FACTS, SimSettings(seed=seed), HEAD)
    for posture in np.random.default_rng(seed).uniform(MODEL.lower, MODEL.upper, (5, 7)):
        cell.move_joints(posture)
        assert distance(cell.pose("world_from_flange"), built.forward(posture)) < 1e-12
        tool = built.forward(posture) @ GEOMETRY.flange_from_tool_tip.transform
        assert distance(cell.pose("world_from_tool_tip"), tool) < 1e-12


def test_a_pose_is_the_same_object_until_its_body_moves(cell: CellState) -> None:
    coil, reference = cell.pose("tracker_from_coil"), cell.pose("tracker_from_body_ref")
    cell.move_joints(HOME)
    assert cell.pose("tracker_from_coil") is coil
    cell.move_joints(HOME + 0.01)
    assert cell.pose("tracker_from_coil") is not coil
    assert cell.pose("tracker_from_body_ref") is reference


def test_the_head_hides_spheres_as_its_formula_says(cell: CellState) -> None:
    """Spheres at random places around the head, against samples of each line of sight."""
    rng, hidden, image_from_world = np.random.default_rng(5), 0, HEAD.world_from_image.inverse()
    centre = HEAD.world_from_image @ head.CENTRE
    cell.fix("body_ref", Transform.identity())  # inside the head, where it hides nothing
    for _ in range(300):
        away = rng.normal(size=3)
        pose = facing_tracker(centre + rng.uniform(0.17, 0.25) * away / np.linalg.norm(away))
        cell.place("pointer", pose)
        seen = cell.sight("pointer").seen
        for point, is_seen in zip(spheres("pointer", pose), seen, strict=True):
            line = point + np.linspace(0.0, 1.0, 2000)[:, None] * (EYE - point)
            level = float(head.level(image_from_world @ line).min())
            if abs(level) > 0.01 and not _behind_arm(cell, point, HOME):
                assert is_seen == (level > 0.0)
                hidden += level < 0.0
    assert 50 < hidden < 900


def _behind_arm(cell: CellState, point: Floats, posture: Floats) -> bool:
    """Whether the arm, its tool or something near it may hide a point, generously."""
    flange = MODEL.forward(posture).translation
    tip = (MODEL.forward(posture) @ GEOMETRY.flange_from_tool_tip.transform).translation
    line = point + np.linspace(0.0, 1.0, 200)[:, None] * (EYE - point)
    return bool((Capsule(flange, tip, 0.2).distance(line) < 0.0).any())


def test_an_arm_in_between_hides_the_spheres_behind_it(cell: CellState) -> None:
    """Behind the flange, and at the same place while the arm stands upright."""
    flange = MODEL.forward(HOME).translation
    away = (flange - EYE) / np.linalg.norm(flange - EYE)
    pose = facing_tracker(flange + 0.15 * away)
    cell.place("pointer", pose)
    assert cell.sight("pointer").seen.sum() < FEWEST_SPHERES
    cell.move_joints(np.zeros(7))
    assert cell.sight("pointer").seen.all()


def test_a_hand_before_the_reference_hides_it(cell: CellState) -> None:
    assert cell.sight("body_ref").seen.all()
    reference = WORLD_FROM_TRACKER @ cell.pose("tracker_from_body_ref")
    towards = (reference.translation - EYE) / np.linalg.norm(reference.translation - EYE)
    place = EYE + 0.6 * towards
    pointer = facing_tracker(place)
    cell.place("pointer", pointer)
    cell.refresh()
    pointer = Transform(pointer.rotation, 2.0 * place - cell.data.geom("hand").xpos)
    cell.place("pointer", pointer)
    assert cell.sight("body_ref").seen.sum() < FEWEST_SPHERES
    cell.place("pointer", Transform(pointer.rotation, np.add(pointer.translation, (0.0, 0.0, 0.25))))
    assert cell.sight("body_ref").seen.all()


def test_spheres_are_not_seen_from_behind(cell: CellState) -> None:
    pose = facing_tracker(np.array((0.6, -0.3, 0.3)))
    cell.place("pointer", pose)
    assert cell.sight("pointer").seen.all()
    half_turn = Transform.from_rotvec(np.zeros(3), np.pi * MARKER_BODIES["pointer"].plane.rotation[:, 0])
    cell.place("pointer", pose @ half_turn)
    assert not cell.sight("pointer").seen.any()


@pytest.mark.parametrize(
    ("place", "inside"),
    [((0.0, 0.0, -1.2), True), ((0.0, 0.0, -0.4), False), ((0.0, 0.0, -2.6), False), ((1.2, 0.0, -1.2), False)],
)
def test_outside_of_its_volume_the_tracker_measures_nothing(
    cell: CellState, place: tuple[float, float, float], inside: bool
) -> None:
    cell.place("pointer", facing_tracker(WORLD_FROM_TRACKER @ np.array(place)))
    sight = cell.sight("pointer")
    assert sight.inside.tolist() == [inside] * 4
    assert not (sight.seen & ~sight.inside).any()


def test_a_bumped_reference_moves_on_the_patient(cell: CellState) -> None:
    before = cell.pose("tracker_from_body_ref")
    bump = Transform.from_rotvec((0.005, 0.0, 0.002), (0.0, 0.05, 0.0))
    cell.fix("body_ref", HEAD.body_ref_from_image.inverse() @ bump)
    assert (before.inverse() @ cell.pose("tracker_from_body_ref")).matrix == pytest.approx(bump.matrix, abs=1e-12)
