"""Grids of voxels: units and directions, and the limits of a volume."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pcmrs.errors import FileFormatError
from pcmrs.formats.grid import LEAST_EDGE, MAX_VOXELS, MOST_EDGE, as_ras, check_grid, check_size
from pcmrs.spatial import Floats

FILE = Path("head.nii")


@given(st.integers(0, 2**32 - 1), st.sampled_from([("m", 1.0), ("mm", 1e-3), ("um", 1e-6)]))
def test_lps_keeps_lengths_and_handedness(seed: int, declared: tuple[str, float]) -> None:
    unit, metres = declared
    points = np.random.default_rng(seed).normal(size=(3, 3))
    found = as_ras(points, unit, "LPS")
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), metres * np.linalg.norm(points, axis=1))
    assert np.linalg.det(found) == pytest.approx(metres**3 * np.linalg.det(points))
    np.testing.assert_allclose(as_ras(found, "m", "LPS"), as_ras(points, unit, "RAS"))


@pytest.mark.parametrize("shape", [(20, 20), (20, 20, 1), (20, 20, 20, 2), (0, 20, 20)])
def test_a_volume_has_three_axes_and_two_slices(shape: tuple[int, ...]) -> None:
    with pytest.raises(FileFormatError, match="at least two slices"):
        check_size(FILE, shape)


def test_too_many_voxels_are_refused_with_value_and_limit() -> None:
    check_size(FILE, (MAX_VOXELS // 4, 2, 2))
    with pytest.raises(FileFormatError, match="Crop it") as refused:
        check_size(FILE, (MAX_VOXELS // 4 + 1, 2, 2))
    assert (refused.value.fields["value"], refused.value.fields["limit"]) == (MAX_VOXELS + 4, MAX_VOXELS)


def grid(*edges: float) -> Floats:
    """A turned grid of voxels with these edges, in m."""
    found = np.eye(4)
    found[:3, :3] = Rotation.from_rotvec((0.3, -0.4, 0.6)).as_matrix() * edges
    return found


@pytest.mark.parametrize("edge", [LEAST_EDGE, MOST_EDGE])
def test_edges_of_voxels_have_limits(edge: float) -> None:
    just = edge * (1.0 + 1e-9 if edge == LEAST_EDGE else 1.0 - 1e-9)
    check_grid(FILE, grid(0.001, just, 0.001))
    with pytest.raises(FileFormatError, match=r"the limits are 0\.01 to 20 mm"):
        check_grid(FILE, grid(0.001, edge * (0.99 if edge == LEAST_EDGE else 1.01), 0.001))


def test_voxels_without_extent_or_position_are_refused() -> None:
    flat = grid(0.001, 0.001, 0.001)
    flat[:3, 2] = flat[:3, 0] + flat[:3, 1]
    with pytest.raises(FileFormatError, match="lie in one plane"):
        check_grid(FILE, flat)
    nowhere = grid(0.001, 0.001, 0.001)
    nowhere[0, 3] = np.nan
    with pytest.raises(FileFormatError, match="the limits are"):
        check_grid(FILE, nowhere)
