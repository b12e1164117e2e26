"""Files are read beside the page, and what cannot be planned on is refused with its reason."""

from __future__ import annotations

import asyncio
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from nicegui.elements.upload_files import SmallFileUpload

from pcmrs.console.planning import files
from pcmrs.console.planning.files import read_points, read_surface
from pcmrs.console.planning.upload_form import stored
from pcmrs.errors import FileFormatError

BALL = trimesh.creation.icosphere(subdivisions=4, radius=90.0)


def markups(path: Path, **changed: Any) -> Path:
    points = [{"label": "nasion", "position": [0.0, -90.0, 0.0], "positionStatus": "defined"}]
    markup = {"type": "Fiducial", "coordinateSystem": "LPS", "coordinateUnits": "mm", "controlPoints": points}
    path.write_text(json.dumps({"markups": [markup | changed]}))
    return path


async def test_a_mesh_is_read_by_another_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "read_mesh", None)  # in this one it would fail
    BALL.export(tmp_path / "head.stl")
    mesh = await read_surface(tmp_path / "head.stl", "mm", "RAS", None)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices, axis=1), 0.09, atol=1e-6)
    (tmp_path / "broken.stl").write_bytes(b"solid nonsense")
    with pytest.raises(FileFormatError, match=r"broken\.stl") as caught:
        await read_surface(tmp_path / "broken.stl", "mm", "RAS", None)
    assert caught.value.fields["file"].endswith("broken.stl")


def test_points_come_in_ras_and_metres(tmp_path: Path) -> None:
    found = files._points(markups(tmp_path / "F.mrk.json"))
    assert found.names == ("nasion",)
    np.testing.assert_allclose(found.points, [[0.0, 0.09, 0.0]])


def test_what_is_no_plan_is_refused_with_its_reason(tmp_path: Path) -> None:
    BALL.export(tmp_path / "head.ply")
    with pytest.raises(FileFormatError, match="Give its other unit"):
        files._surface(tmp_path / "head.ply", "m", "RAS", None)
    with pytest.raises(FileFormatError, match="no volume"):
        files._surface(tmp_path / "head.vtk", "mm", "RAS", None)
    for changed in ({"coordinateSystem": "IJK"}, {"coordinateUnits": "inch"}, {"type": "Curve"}):
        with pytest.raises(FileFormatError, match=r"F\.mrk\.json"):
            files._points(markups(tmp_path / "F.mrk.json", **changed))
    (tmp_path / "d.yaml").write_text(DIGITIZED)
    with pytest.raises(FileFormatError, match="digitized"):
        files._points(tmp_path / "d.yaml")


def dies(path: Path) -> None:
    os._exit(1)


@pytest.mark.nightly
async def test_a_file_that_ends_its_reader_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match="ended the process"):
        await files._apart(dies, tmp_path / "a.stl")


async def test_what_takes_too_long_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(files, "PATIENCE", 0.0)
    with pytest.raises(FileFormatError, match="took more than"):
        await read_points(markups(tmp_path / "F.mrk.json"))


DIGITIZED = "DIGITIZED:\n  p0: {x: 0.1, y: 0.2, z: 0.3}\n"


@pytest.mark.parametrize("name", ["../evil.stl", "/tmp/evil.stl", "a/../../evil.nii.gz", "..", ".", ""])
def test_a_file_stays_in_the_folder_it_is_put_into(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "upload"
    folder.mkdir()
    path = asyncio.run(stored([SmallFileUpload(name, "", b"evil")], folder))
    assert path.read_bytes() == b"evil"
    assert {*tmp_path.rglob("*")} == {folder, path}
    assert path.parent == folder
