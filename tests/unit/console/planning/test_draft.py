"""What is planned on the page stands where it should, or is refused and leaves the plan as it was."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.console.planning._draft import MOVES, TURN, TURNS, Draft, typed_point
from pcmrs.errors import GeometryError
from pcmrs.formats.landmarks import read_landmarks
from pcmrs.formats.mesh import read_mesh
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Floats, rotation_angle
from tests import ROOT
from tests.unit.console.planning.drafts import RADIUS, direction, draft

EXAMPLES = ROOT / "examples"

FLAT = 0.001
"""Corners of the ball are flatter than a sphere by less than this, m."""


@given(st.integers(0, 10_000), st.integers(0, 10_000))
def test_the_tool_stands_tangent_and_keeps_its_handle(first: int, second: int) -> None:
    plan = draft()
    for seed in (first, second):
        plan.place(RADIUS * direction(seed))
        assert plan.pose is not None
        outwards = plan.pose.translation / np.linalg.norm(plan.pose.translation)
        assert outwards @ direction(seed) > 0.999
        assert plan.pose.rotation[:, 2] @ outwards > 0.999


@given(st.integers(0, 10_000), st.lists(st.sampled_from([*MOVES, *TURNS, "Enter"]), max_size=8))
def test_keys_move_it_along_the_surface_and_turn_it_in_place(seed: int, keys: list[str]) -> None:
    plan = draft()
    plan.place(RADIUS * direction(seed))
    for key in keys:
        before = plan.pose
        plan.move(key)
        assert before is not None
        assert plan.pose is not None
        moved = float(np.linalg.norm(plan.pose.translation - before.translation))
        assert moved == pytest.approx(0.001 if key in MOVES else 0.0, abs=2e-5)
        if key in TURNS:
            assert rotation_angle(plan.pose, before) == pytest.approx(TURN)
        assert abs(np.linalg.norm(plan.pose.translation) - RADIUS) < FLAT


@given(st.integers(0, 10_000), st.floats(0.03, 0.08))
def test_target_is_projected_to_nearest_point_or_along_direction(seed: int, away: float) -> None:
    plan, target = draft(), away * direction(seed)
    plan.aim(target)
    assert plan.pose is not None
    assert plan.depth == pytest.approx(RADIUS - away, abs=FLAT)
    along = direction(seed + 1)
    plan.aim(target, 5.0 * along)
    offset = plan.pose.translation - target
    assert np.linalg.norm(np.cross(offset, along)) < FLAT
    assert offset @ along > 0.0
    assert np.linalg.norm(plan.pose.translation) == pytest.approx(RADIUS, abs=FLAT)


def test_the_direction_may_be_the_cortex_own() -> None:
    plan, target = draft(), np.array((0.03, 0.0, 0.06))
    with pytest.raises(GeometryError, match="cortex"):
        plan.normal_at(target)
    gyrus = trimesh.creation.icosphere(subdivisions=3, radius=0.02)
    plan.cortex = TriangleSurface(gyrus.vertices + target - (0.02, 0.0, 0.0), gyrus.faces)
    normal = plan.normal_at(target)
    assert normal @ (1.0, 0.0, 0.0) > 0.99
    plan.aim(target, normal)
    assert plan.pose is not None
    np.testing.assert_allclose(plan.pose.translation, (np.sqrt(RADIUS**2 - 0.06**2), 0.0, 0.06), atol=0.003)


def test_points_of_another_space_are_refused_and_change_nothing() -> None:
    plan = draft()
    on_it = RADIUS * np.array([direction(seed) for seed in range(4)])
    names = ["a", "b", "c", "d"]
    plan.load_landmarks(names, on_it)
    before = list(plan.landmarks)
    for points in (on_it * 1000.0, on_it + np.array((0.0, 0.0, 0.05)), np.vstack((on_it[:3], on_it[3:] * 0.5))):
        with pytest.raises(GeometryError, match="from the surface; the limit is 30 mm"):
            plan.load_landmarks(names, points)
    with pytest.raises(GeometryError, match="already"):
        plan.load_landmarks(["a", "a", "b", "c"], on_it)
    assert plan.landmarks == before
    with pytest.raises(GeometryError, match="limit is 80 mm"):
        plan.aim(np.array((0.0, 0.0, 0.3)))
    with pytest.raises(GeometryError, match="reverse the direction"):
        plan.aim(np.array((0.0, 0.0, 0.12)), np.array((0.0, 0.0, 1.0)))
    assert (plan.pose, plan.target) == (None, None)


def test_phantom_landmarks_are_taken_and_turned_ones_are_refused() -> None:
    for name, body in (("ratms", "head"), ("femoroplasty", "femur")):
        mesh = read_mesh(EXAMPLES / f"{body}_phantom.ply", "m", "RAS")
        planned = read_landmarks(EXAMPLES / f"{name}_plan.json")
        plan = Draft(surface=TriangleSurface(mesh.vertices, mesh.faces))
        with pytest.raises(GeometryError, match="LPS"):  # as if LPS had been written into a file of RAS
            plan.load_landmarks(planned.names, planned.points * np.array((-1.0, -1.0, 1.0)))
        assert plan.landmarks == []
        plan.load_landmarks(planned.names, planned.points)
        assert len(plan.landmarks) == len(planned.names)


@pytest.mark.parametrize(
    ("correction", "mistake"),
    [
        (np.diag((-1.0, -1.0, 1.0)), "in the other space"),
        (np.diag((-1.0, 1.0, 1.0)), "mirrored"),
        (np.eye(3) * 1e3, "1000 times smaller"),
        (np.eye(3) * 1e-3, "1000 times as large"),
    ],
)
def test_a_mesh_that_was_read_wrongly_is_recognized(correction: Floats, mistake: str) -> None:
    """The femur has no plane of symmetry; a mirrored head has the same landmarks, but for their names."""
    mesh = read_mesh(EXAMPLES / "femur_phantom.ply", "m", "RAS")
    planned = read_landmarks(EXAMPLES / "femoroplasty_plan.json")
    plan = Draft(surface=TriangleSurface(mesh.vertices, mesh.faces))
    with pytest.raises(GeometryError, match=f"The landmarks fit a mesh that was read .*{mistake}"):
        plan.load_landmarks(planned.names, planned.points @ correction)
    with pytest.raises(GeometryError) as refused:
        plan.load_landmarks(planned.names, planned.points + 0.2)
    assert "fit a mesh" not in refused.value.text


def test_without_a_surface_nothing_is_placed() -> None:
    with pytest.raises(GeometryError, match="no surface"):
        Draft().place(np.zeros(3))


@pytest.mark.parametrize("text", ["", None, "1 2", "1 2 x", "1 2 3 4", "1 2 nan"])
def test_text_that_is_no_point_is_refused(text: str | None) -> None:
    with pytest.raises(GeometryError, match="three numbers"):
        typed_point(text)


def test_typed_points_are_in_mm() -> None:
    assert typed_point("4, -12 143").tolist() == [0.004, -0.012, 0.143]
