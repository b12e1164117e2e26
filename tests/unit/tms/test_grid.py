"""Walks along the scalp and grids on it: on a sphere by the book, on the phantom by what they promise."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import GeometryError
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Transform
from pcmrs.tms.grid import grid_on_scalp, hexagons, rows_on_scalp
from pcmrs.tms.scalp import along_scalp, turned
from tests.support.trials import examples
from tests.unit.tms.heads import TOP, phantom, sphere

lengths = st.floats(-0.05, 0.05)
BALL_RADIUS = 0.09
BALL = trimesh.creation.icosphere(subdivisions=4, radius=BALL_RADIUS)
SCALP = TriangleSurface(BALL.vertices, BALL.faces)
BALL_TOP = Transform(np.eye(3), np.array((0.0, 0.0, BALL_RADIUS)))


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


@pytest.mark.parametrize(("spacing", "rings"), [(0.0, 2), (-0.01, 2), (float("nan"), 2), (0.01, -1), (0.01, 21)])
def test_invalid_grid_is_refused(spacing: float, rings: int) -> None:
    with pytest.raises(GeometryError, match="positive spacing"):
        grid_on_scalp(sphere, TOP, spacing, rings)


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (3, 3), (2, 5)])
def test_every_pose_is_tangent_and_next_to_the_one_before(rows: int, columns: int) -> None:
    poses = rows_on_scalp(SCALP.closest, BALL_TOP, 0.008, rows, columns)
    places = np.array([pose.translation for pose in poses])
    assert len(poses) == rows * columns
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), BALL_RADIUS, atol=0.0005)
    for pose in poses:
        assert pose.rotation[:, 2] @ pose.translation > 0.999 * np.linalg.norm(pose.translation)
    np.testing.assert_allclose(np.linalg.norm(np.diff(places, axis=0), axis=1), 0.008, atol=0.0006)
    assert np.linalg.norm(places.mean(axis=0)[:2]) < 1e-3, "the tool is its middle"
    if rows > 1:
        assert places[0, 0] < 0.0 < places[0, 1], "it begins to the left, ahead"


@pytest.mark.parametrize(("spacing", "rows", "columns"), [(0.0, 3, 3), (np.nan, 3, 3), (0.01, 0, 3), (0.01, 3, 21)])
def test_no_grid_is_refused(spacing: float, rows: int, columns: int) -> None:
    with pytest.raises(GeometryError, match="positive spacing"):
        rows_on_scalp(SCALP.closest, BALL_TOP, spacing, rows, columns)
