"""The process that reads an uploaded file refuses what cannot be planned on, with value, limit and what to do."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcmrs.console.planning import importer
from pcmrs.console.planning.importer import LEAST_EXTENT, MOST_EXTENT, read_points, read_surface
from pcmrs.errors import FileFormatError
from pcmrs.formats.grid import Unit


def ball(folder: Path, radius: float, subdivisions: int = 1) -> Path:
    trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius).export(folder / "ball.stl")
    return folder / "ball.stl"


def test_a_mesh_comes_in_metres_and_in_ras(tmp_path: Path) -> None:
    path = ball(tmp_path, 90.0)
    ras, lps = (read_surface(path, "mm", space, None) for space in ("RAS", "LPS"))
    assert np.ptp(ras.vertices, axis=0) == pytest.approx(np.full(3, 0.18), rel=0.1)
    np.testing.assert_allclose(lps.vertices, ras.vertices * (-1.0, -1.0, 1.0), atol=1e-9)


@pytest.mark.parametrize(("radius", "unit"), [(90.0, "m"), (0.09, "mm"), (5.0, "mm"), (1100.0, "mm")])
def test_a_surface_in_the_wrong_unit_is_refused(tmp_path: Path, radius: float, unit: Unit) -> None:
    with pytest.raises(FileFormatError, match="Change the unit") as error:
        read_surface(ball(tmp_path, radius), unit, "RAS", None)
    assert not LEAST_EXTENT <= error.value.fields["value"] <= MOST_EXTENT


def test_a_surface_that_no_browser_shows_in_time_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = ball(tmp_path, 90.0, subdivisions=2)
    faces = len(trimesh.load_mesh(path).faces)
    monkeypatch.setattr(importer, "MOST_FACES", faces)
    assert len(read_surface(path, "mm", "RAS", None).faces) == faces
    monkeypatch.setattr(importer, "MOST_FACES", faces - 1)
    with pytest.raises(FileFormatError, match="Simplify it") as error:
        read_surface(path, "mm", "RAS", None)
    assert (error.value.fields["value"], error.value.fields["limit"]) == (faces, faces - 1)


def markups(path: Path, count: int) -> Path:
    points = [
        {"label": f"p{number}", "position": [1.0 * number, 0.0, 0.0], "positionStatus": "defined"}
        for number in range(count)
    ]
    markup = {"type": "Fiducial", "coordinateSystem": "RAS", "coordinateUnits": "mm", "controlPoints": points}
    path.write_text(json.dumps({"markups": [markup]}))
    return path


def test_digitized_landmarks_are_not_planned_on(tmp_path: Path) -> None:
    (tmp_path / "d.yaml").write_text("DIGITIZED:\n  p0: {x: 0.1, y: 0.2, z: 0.3}\n")
    with pytest.raises(FileFormatError, match="holds digitized landmarks"):
        read_points(tmp_path / "d.yaml")
    (tmp_path / "p.yaml").write_text("PLANNED:\n  p0: {x: 0.1, y: 0.2, z: 0.3}\n")
    assert read_points(tmp_path / "p.yaml").names == ("p0",)


def test_too_many_points_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importer, "MOST_POINTS", 3)
    assert len(read_points(markups(tmp_path / "three.mrk.json", 3)).names) == 3
    with pytest.raises(FileFormatError, match="holds 4 points; the limit is 3"):
        read_points(markups(tmp_path / "four.mrk.json", 4))
