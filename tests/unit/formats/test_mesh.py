"""Meshes, as another program would have written them, in each declared unit and direction."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcmrs.errors import FileFormatError
from pcmrs.formats import mesh as mesh_file
from pcmrs.formats.grid import Space, Unit
from pcmrs.formats.mesh import read_mesh

SOLID = trimesh.creation.icosphere(subdivisions=2, radius=0.09)
TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
PLY_POINTS = (
    "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n"
)


@pytest.mark.parametrize("kind", ["stl", "ply", "obj", "stl_ascii"])
@pytest.mark.parametrize(("unit", "space"), [("m", "RAS"), ("mm", "LPS")])
def test_the_surface_comes_back_in_ras_and_metres(kind: str, unit: Unit, space: Space, tmp_path: Path) -> None:
    moved = SOLID.copy()
    moved.vertices += (0.01, 0.02, 0.03)
    stored = moved.copy()
    stored.vertices *= np.array((1, 1, 1) if space == "RAS" else (-1, -1, 1)) * (1.0 if unit == "m" else 1e3)
    path = tmp_path / f"surface.{kind.removesuffix('_ascii')}"
    stored.export(path, file_type=kind)
    found = read_mesh(path, unit, space)
    assert found.vertices.shape == moved.vertices.shape  # an STL holds every corner six times
    assert found.faces.shape == moved.faces.shape
    read = trimesh.Trimesh(found.vertices, found.faces, process=False)
    assert read.volume == pytest.approx(moved.volume, rel=1e-5)  # positive: it still faces outwards
    np.testing.assert_allclose(read.bounds, moved.bounds, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "raw", "reason"),
    [
        ("a.vtk", b"", "suffix must be one of"),
        ("a.stl", b"", "no triangles"),
        ("a.stl", b"\0" * 80 + b"\xff\xff\xff\xff" + b"1" * 50, "not a mesh in STL|no triangles"),
        ("a.ply", b"nonsense", "not a mesh in PLY: ValueError"),
        ("a.ply", PLY_POINTS.encode(), "no triangles"),
        ("a.obj", b"nonsense", "no triangles"),
        ("a.obj", (TRIANGLE + "f 1 2 9\n").encode(), "not a mesh in OBJ|does not hold"),
        ("a.obj", (TRIANGLE.replace("1 0 0", "nan 0 0") + "f 1 2 3\n").encode(), "not finite"),
    ],
)
def test_invalid_mesh_is_refused_with_file_and_reason(name: str, raw: bytes, reason: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(raw)
    with pytest.raises(FileFormatError, match=reason) as caught:
        read_mesh(path, "m", "RAS")
    assert str(path) in caught.value.text


def test_corners_with_two_coordinates_are_refused(tmp_path: Path) -> None:
    """Found by `fuzz.meshes`: it ended with another error than the refusal."""
    (tmp_path / "flat.obj").write_text("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n")
    with pytest.raises(FileFormatError, match=r"flat\.obj"):
        read_mesh(tmp_path / "flat.obj", "mm", "RAS")


def test_a_huge_mesh_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_file, "MAX_MESH_BYTES", 1000)
    path = tmp_path / "a.stl"
    SOLID.export(path)
    with pytest.raises(FileFormatError, match="longer than 1000 bytes"):
        read_mesh(path, "m", "RAS")
