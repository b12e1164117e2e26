"""A rectangular grid lies on the scalp, in the order in which it is gone through."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pcmrs.errors import GeometryError
from pcmrs.registration.triangles import TriangleSurface
from pcmrs.spatial import Transform
from pcmrs.tms.grid import rows_on_scalp

RADIUS = 0.09
BALL = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
SCALP = TriangleSurface(BALL.vertices, BALL.faces)
TOP = Transform(np.eye(3), np.array((0.0, 0.0, RADIUS)))


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (3, 3), (2, 5)])
def test_every_pose_is_tangent_and_next_to_the_one_before(rows: int, columns: int) -> None:
    poses = rows_on_scalp(SCALP.closest, TOP, 0.008, rows, columns)
    places = np.array([pose.translation for pose in poses])
    assert len(poses) == rows * columns
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), RADIUS, atol=0.0005)
    for pose in poses:
        assert pose.rotation[:, 2] @ pose.translation > 0.999 * np.linalg.norm(pose.translation)
    np.testing.assert_allclose(np.linalg.norm(np.diff(places, axis=0), axis=1), 0.008, atol=0.0006)
    assert np.linalg.norm(places.mean(axis=0)[:2]) < 1e-3, "the tool is its middle"
    if rows > 1:
        assert places[0, 0] < 0.0 < places[0, 1], "it begins to the left, ahead"


@pytest.mark.parametrize(("spacing", "rows", "columns"), [(0.0, 3, 3), (np.nan, 3, 3), (0.01, 0, 3), (0.01, 3, 21)])
def test_no_grid_is_refused(spacing: float, rows: int, columns: int) -> None:
    with pytest.raises(GeometryError, match="positive spacing"):
        rows_on_scalp(SCALP.closest, TOP, spacing, rows, columns)
