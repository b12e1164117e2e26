"""Walks along the scalp and grids on it: on a sphere by the book, on the phantom by what they promise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import GeometryError
from pcmrs.spatial import Transform, rotation_angle
from pcmrs.tms.grid import grid_on_scalp, hexagons
from pcmrs.tms.scalp import along_scalp, hand_area, heading, on_scalp, turned
from tests.support.trials import examples
from tests.unit.tms.heads import RADIUS, TOP, phantom, sphere

lengths = st.floats(-0.05, 0.05)


@given(lengths, lengths, st.floats(-3.0, 3.0))
def test_a_walk_on_a_sphere_follows_its_great_circle(x: float, y: float, angle: float) -> None:
    """Rotating the whole sphere about the axis across the way carries the coil along without a turn of its handle."""
    start = turned(TOP, angle)
    (found,) = along_scalp(sphere, start, [[x, y]])
    axis = np.cross((0.0, 0.0, 1.0), start.rotation @ np.array((x, y, 0.0)))
    # Each step is along the tangent, whose angle is smaller than its length says, by at most 1 in 5000.
    expected = Transform.from_rotvec((0.0, 0.0, 0.0), axis / RADIUS) @ start
    assert np.linalg.norm(found.translation - expected.translation) < 2e-5
    assert rotation_angle(found, expected) < 3e-4


@examples(25)
@given(st.floats(0.002, 0.012), st.integers(0, 4), st.floats(-np.pi, np.pi), lengths, lengths)
def test_poses_of_a_grid_lie_on_the_scalp_in_order(
    spacing: float, rings: int, angle: float, x: float, y: float
) -> None:
    surface, usual = phantom()
    (moved,) = along_scalp(surface.closest, usual, [[x, y]])
    grid = grid_on_scalp(surface.closest, turned(moved, angle), spacing, rings)
    assert len(grid) == 1 + 3 * rings * (rings + 1)
    positions = np.array([pose.translation for pose in grid])
    nearest, normals = surface.closest(positions)
    assert np.abs(nearest - positions).max() < 1e-9
    assert np.abs(np.array([pose.rotation[:, 2] for pose in grid]) - normals).max() < 1e-9
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert steps.max(initial=0.0) < 1.02 * spacing  # chords; and the mesh has edges
    assert steps.min(initial=spacing) > 0.75 * spacing  # circles on a head are shorter than on a plane


def test_a_grid_goes_outwards_in_a_spiral_of_neighbours() -> None:
    places = hexagons(6)
    assert np.allclose(np.linalg.norm(np.diff(places, axis=0), axis=1), 1.0)
    assert len(np.unique(places.round(6), axis=0)) == 127
    reached = np.linalg.norm(places, axis=1)
    for ring in range(1, 7):
        mine = reached[1 + 3 * ring * (ring - 1) : 1 + 3 * ring * (ring + 1)]
        assert ring * np.sqrt(0.75) - 1e-9 <= mine.min()
        assert mine.max() <= ring + 1e-9


def test_pose_beside_the_scalp_is_moved_onto_it_with_least_tilt() -> None:
    beside = Transform.from_rotvec((0.001, 0.0, RADIUS + 0.01), (0.2, 0.0, 0.7))
    placed = on_scalp(sphere, beside)
    assert np.linalg.norm(placed.translation) == pytest.approx(RADIUS)
    assert np.allclose(placed.rotation[:, 2], placed.translation / RADIUS)
    cosine = beside.rotation[:, 2] @ placed.rotation[:, 2]
    assert rotation_angle(beside, placed) == pytest.approx(np.arccos(cosine))


@pytest.mark.parametrize(("side", "sign"), [("right", 1.0), ("left", -1.0)])
def test_hand_area_is_beside_the_vertex_with_handle_back_and_out(side: str, sign: float) -> None:
    pose = hand_area(sphere, TOP.translation, "right" if side == "right" else "left")
    away = RADIUS * np.arccos(pose.translation[2] / RADIUS)
    assert away == pytest.approx(np.hypot(0.055, 0.005), rel=1e-3)
    assert sign * pose.translation[0] > 0.05 * 0.9
    handle = -pose.rotation[:, 1]
    assert sign * handle[0] > 0.3
    assert handle[1] < -0.6


@given(st.floats(-3.1, 3.1), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_the_heading_is_the_turn_about_the_normal(angle: float, tilt_x: float, tilt_y: float) -> None:
    tilt = Transform.from_rotvec((0.0, 0.0, 0.0), (tilt_x, tilt_y, 0.0))
    assert heading(TOP, tilt @ turned(TOP, angle)) == pytest.approx(angle, abs=1e-9)


@pytest.mark.parametrize(("spacing", "rings"), [(0.0, 2), (-0.01, 2), (float("nan"), 2), (0.01, -1), (0.01, 21)])
def test_invalid_grid_is_refused(spacing: float, rings: int) -> None:
    with pytest.raises(GeometryError, match="positive spacing"):
        grid_on_scalp(sphere, TOP, spacing, rings)


def test_upside_down_coil_and_invalid_offsets_are_refused() -> None:
    flipped = Transform.from_rotvec(TOP.translation, (np.pi, 0.0, 0.0))
    with pytest.raises(GeometryError, match="into the head"):
        on_scalp(sphere, flipped)
    for offsets in ([[0.0, float("nan")]], [[0.0, 0.0, 0.0]], [0.0, 0.0]):
        with pytest.raises(GeometryError, match="pairs"):
            along_scalp(sphere, TOP, offsets)
