"""Files are read beside the page, and what cannot be planned on is refused with its reason."""

from __future__ import annotations

import asyncio
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from nicegui.elements.upload_files import SmallFileUpload

from pcmrs.console.planning import files, importer
from pcmrs.console.planning.files import read_points, read_surface
from pcmrs.console.planning.upload_form import store_upload
from pcmrs.errors import FileFormatError

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


CONFINED = """
import os, resource, socket, subprocess, sys, threading
from pcmrs.console.planning.confined import confine

go, out = threading.Event(), []
def beside():
    go.wait()
    out.append(refused(socket.socket))
def refused(act, *words):
    try:
        act(*words)
    except (OSError, MemoryError) as error:
        return type(error).__name__
    return "done"
thread = threading.Thread(target=beside, daemon=True)
thread.start()
file = os.open(sys.argv[2], os.O_WRONLY | os.O_CREAT)
if sys.argv[1] == "confined":
    confine(2**30, 60)
out += [refused(socket.socket), refused(subprocess.run, ["/bin/true"])]
out += [refused(bytes, 2**31), refused(os.write, file, b"x")]
go.set()
thread.join()
print(*out)
"""


@pytest.mark.parametrize("how", ["free", "confined"])
def test_reader_has_no_network_no_programs_and_little_memory(how: str, tmp_path: Path) -> None:
    words = [sys.executable, "-c", CONFINED, how, str(tmp_path / "file")]
    said = subprocess.run(words, capture_output=True, text=True, check=True, timeout=120).stdout.split()
    ended = ["PermissionError", "PermissionError", "MemoryError", "OSError", "PermissionError"]
    assert said == (ended if how == "confined" else ["done"] * 5)


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


@pytest.mark.parametrize("name", ["../evil.stl", "/tmp/evil.stl", "a/../../evil.nii.gz", "..", ".", ""])
def test_a_file_stays_in_the_folder_it_is_put_into(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "upload"
    folder.mkdir()
    path = asyncio.run(store_upload([SmallFileUpload(name, "", b"evil")], folder))
    assert path.read_bytes() == b"evil"
    assert {*tmp_path.rglob("*")} == {folder, path}
    assert path.parent == folder
