"""The surface of a phantom comes back from its volume; volumes without a surface are refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcmrs.errors import GeometryError
from pcmrs.formats.grid import Volume
from pcmrs.formats.skin import skin_of
from pcmrs.formats.volume import read_volume
from tests.unit.formats.phantom_volumes import check_is_phantom, oblique, phantom, write_nifti

pytest.importorskip("skimage")


@pytest.mark.parametrize("mirrored", [False, True])
def test_the_surface_is_where_the_phantom_is(mirrored: bool, tmp_path: Path) -> None:
    grid = oblique(mirrored)
    for name in ("head.nii", "head.nii.gz"):
        check_is_phantom(skin_of(read_volume(write_nifti(tmp_path / name, phantom(grid), grid))))


def test_a_fine_volume_is_averaged_and_stays_in_place() -> None:
    grid = np.diag((0.0007, 0.0007, 0.0009, 1.0))
    points = np.stack(np.meshgrid(*map(np.arange, (120, 120, 100)), indexing="ij"), axis=-1) * np.diag(grid)[:3]
    middle, radius = np.array((0.042, 0.04, 0.045)), 0.03
    values = np.clip(0.5 - (np.linalg.norm(points - middle, axis=-1) - radius) / 0.0007, 0.0, 1.0)
    mesh = skin_of(Volume(values.astype(np.float32), grid), threshold=0.5)
    lengths = np.linalg.norm(mesh.vertices - middle, axis=1)
    np.testing.assert_allclose(lengths, radius, atol=0.0003)


def test_skin_that_leaves_the_volume_is_closed_at_its_border() -> None:
    values = np.zeros((40, 40, 40), np.float32)
    values[10:30, 10:30, :25] = 1.0
    import trimesh

    mesh = skin_of(Volume(values, np.diag((0.002, 0.002, 0.002, 1.0))))
    assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).is_watertight


@pytest.mark.parametrize(
    ("values", "threshold", "reason"),
    [
        (np.zeros((9, 9, 9)), None, "everywhere"),
        (np.eye(27).reshape(9, 9, 9), 0.99, "Only 0 connected"),
        (np.arange(20**3).reshape(20, 20, 20), -1.0, "Everything"),
    ],
)
def test_a_volume_without_a_surface_is_refused(values: Any, threshold: float | None, reason: str) -> None:
    with pytest.raises(GeometryError, match=reason):
        skin_of(Volume(values.astype(np.float32), np.diag((0.002, 0.002, 0.002, 1.0))), threshold)
