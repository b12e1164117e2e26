"""Files are read beside the page, and what cannot be planned on is refused with its reason."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from pcmrs.console.planning import files, importer
from pcmrs.console.planning.files import read_points, read_surface
from pcmrs.errors import FileFormatError
from tests.unit.formats.phantom_volumes import oblique, phantom, write_dicom, write_nifti

BALL = trimesh.creation.icosphere(subdivisions=4, radius=90.0)


def markups(path: Path, **changed: Any) -> Path:
    points = [{"label": "nasion", "position": [0.0, -90.0, 0.0], "positionStatus": "defined"}]
    markup = {"type": "Fiducial", "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": points}
    path.write_text(json.dumps({"markups": [markup | changed]}))
    return path


async def test_a_mesh_is_read_by_another_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importer, "read_mesh", None)  # in this one it would fail
    BALL.export(tmp_path / "head.stl")
    mesh = await read_surface(tmp_path / "head.stl", "mm", "RAS", None)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 0.09, atol=1e-6)
    (tmp_path / "broken.stl").write_bytes(b"solid nonsense")
    with pytest.raises(FileFormatError, match=r"broken\.stl") as caught:
        await read_surface(tmp_path / "broken.stl", "mm", "RAS", None)
    assert caught.value.fields["file"].endswith("broken.stl")


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "nii.gz", "dicom"])
async def test_each_kind_of_surface_is_read_by_that_process(tmp_path: Path, kind: str) -> None:
    """Its list of system calls suffices for the libraries of all kinds."""
    if kind == "nii.gz":
        path = write_nifti(tmp_path / "head.nii.gz", phantom(oblique()), oblique())
    elif kind == "dicom":
        path = write_dicom(tmp_path / "series", phantom(oblique()), oblique())
    else:
        path = tmp_path / f"head.{kind}"
        BALL.export(path)
    assert len((await read_surface(path, "mm", "RAS", None)).faces) > 1000


def test_points_come_in_ras_and_metres(tmp_path: Path) -> None:
    found = importer.read_points(markups(tmp_path / "F.mrk.json"))
    assert found.names == ("nasion",)
    np.testing.assert_allclose(found.points, [[0.0, 0.09, 0.0]])


def test_invalid_plan_file_is_refused_with_the_reason(tmp_path: Path) -> None:
    BALL.export(tmp_path / "head.ply")
    with pytest.raises(FileFormatError, match="Change the unit"):
        importer.read_surface(tmp_path / "head.ply", "m", "RAS", None)
    with pytest.raises(FileFormatError, match="not a volume"):
        importer.read_surface(tmp_path / "head.vtk", "mm", "RAS", None)
    for changed in ({"coordinateSystem": "IJK"}, {"coordinateUnits": "inch"}, {"type": "Curve"}):
        with pytest.raises(FileFormatError, match=r"F\.mrk\.json"):
            importer.read_points(markups(tmp_path / "F.mrk.json", **changed))
    (tmp_path / "d.yaml").write_text(DIGITIZED)
    with pytest.raises(FileFormatError, match="digitized"):
        importer.read_points(tmp_path / "d.yaml")


async def test_points_come_from_another_process(tmp_path: Path) -> None:
    found = await read_points(markups(tmp_path / "F.mrk.json"))
    assert (found.names, found.role) == (("nasion",), None)
    np.testing.assert_allclose(found.points, [[0.0, 0.09, 0.0]])


def answering(monkeypatch: pytest.MonkeyPatch, program: str) -> None:
    """Has another program stand in for the reader, as one that a file has taken over."""
    monkeypatch.setattr(files, "_CHILD", (sys.executable, "-c", f"import os, sys\n{program}"))


@pytest.mark.parametrize(
    ("program", "word"),
    [
        ("os._exit(1)", "ended the process"),
        ("sys.stdout.buffer.write(b'nonsense')", "neither a surface nor points"),
        ("import pickle; sys.stdout.buffer.write(pickle.dumps(print))", "neither a surface nor points"),
        ("import msgspec; sys.stdout.buffer.write(msgspec.msgpack.encode({'type': 'refused', 'text': 'so'}))", "so"),
        ("while True: sys.stdout.buffer.write(bytes(1 << 20))", "neither a surface nor points"),
    ],
)
async def test_whatever_the_reader_says_is_only_data(
    program: str, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    answering(monkeypatch, program)
    with pytest.raises(FileFormatError, match=word):
        await read_points(tmp_path / "a.json")


@pytest.mark.parametrize(
    ("vertices", "faces"),
    [
        ([[0.0, 0.0, 0.0]], [[0, 0, 1]]),
        ([[0.0, 0.0, 0.0]], [[0, -1, 0]]),
        ([[0.0, 0.0, float("nan")]], [[0, 0, 0]]),
        ([[0.0, 0.0, 0.0]], []),
        ([[0.0, 0.0]], [[0, 0, 0]]),
        ([[0.0, 0.0, 0.0]], [[0, 0, 0]] * (importer.MOST_FACES + 1)),
    ],
)
def test_invalid_surface_is_refused(vertices: list[list[float]], faces: list[list[int]]) -> None:
    answer = importer.SurfaceAnswer(np.array(vertices).tobytes(), np.array(faces, dtype=np.int64).tobytes())
    with pytest.raises(FileFormatError, match="neither a surface"):
        files.surface_in(Path("a.stl"), answer)
    with pytest.raises(FileFormatError, match="neither a surface"):
        files.surface_in(Path("a.stl"), importer.PointsAnswer((), (), None))


async def test_reader_without_memory_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    BALL.export(tmp_path / "head.stl")
    monkeypatch.setattr(files, "MEMORY", 2**20)
    with pytest.raises(FileFormatError, match="for lack of memory"):
        await read_surface(tmp_path / "head.stl", "mm", "RAS", None)


async def test_reader_that_takes_too_long_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "PATIENCE", 0.0)
    with pytest.raises(FileFormatError, match="took more than"):
        await read_points(markups(tmp_path / "F.mrk.json"))


DIGITIZED = "DIGITIZED:\n  p0: {x: 0.1, y: 0.2, z: 0.3}\n"
