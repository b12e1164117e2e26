"""`pcmrs calibrate tip` on files, and its errors in the predicted error at a target."""

from __future__ import annotations

import json
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from trimesh import Trimesh
from trimesh.creation import icosphere

from pcmrs.calibration import read_calibration, write_calibration
from pcmrs.calibration.poses import POINT, TIP_PIVOT, TOUCHED, header, read_touches, write_poses
from pcmrs.clock import SystemClock
from pcmrs.errors import FileFormatError
from pcmrs.spatial import Floats, Transform, distance, rotation_angle
from tests.unit.calibration.calibrations import a_pointer, a_tool
from tests.unit.cli.calibrate.calibrations import run

TIP = Transform.from_rotvec((-0.06, 0.03, -0.06), (0.8, 0.4, 0.8))
TIP_IN_POINTER = np.array((0.0, 0.0, -0.149))
POINTS = np.array([(0.0, 0.0, 0.0), (0.05, 0.0, 0.01), (-0.05, 0.01, 0.01), (0.0, 0.06, 0.02)])
TRACKER_FROM_MARKER = Transform.from_rotvec((0.1, -0.2, 1.6), (0.3, 2.0, 0.5))


def pointer_file(folder: Path, days: float = 0.0) -> str:
    date = datetime.fromtimestamp(int(SystemClock().wall()), UTC) - timedelta(days=days)
    write_calibration(folder / "stylus.toml", a_pointer(date=date, sha256="", error_mm=0.1))
    return str(folder / "stylus.toml")


def touches_file(folder: Path, points: Floats, known: Sequence[bool], sigma: float = 1e-4) -> str:
    """Touches of points of the tool, with the known ones named."""
    rng = np.random.default_rng(1)
    lines = [f"{header(TOUCHED)},{','.join(f'{POINT}_{axis}_mm' for axis in 'xyz')}"]
    for point, named in zip(points, known, strict=True):
        tilt = Transform.from_rotvec((0.0, 0.0, 0.0), rng.uniform(-0.5, 0.5, 3))
        at = TRACKER_FROM_MARKER @ (TIP @ point) + rng.normal(0.0, sigma, 3)
        pointer = Transform(tilt.rotation, at - tilt.rotation @ TIP_IN_POINTER)
        values = [*TRACKER_FROM_MARKER.translation, *TRACKER_FROM_MARKER.quat_xyzw]
        values += [*pointer.translation, *pointer.quat_xyzw]
        names = [f"{1000.0 * value:.6f}" for value in point] if named else ["", "", ""]
        lines.append(",".join([*(f"{value:.9g}" for value in values), *names]))
    (folder / "touches.csv").write_text("\n".join(lines) + "\n")
    return str(folder / "touches.csv")


def test_touched_points_write_a_tip_with_its_error(tmp_path: Path) -> None:
    output, file = tmp_path / "tip.toml", touches_file(tmp_path, POINTS, [True] * 4)
    words = ("tip", "points", file, "--pointer", pointer_file(tmp_path), "-o", str(output), "--name", "MC-B70")
    ended = run(*words)
    assert ended.exit_code == 0, ended.output
    assert "predicted rms error" in ended.stdout
    found = read_calibration(output)
    assert (found.kind, found.type, found.name, found.cell) == ("tip", "coil", "MC-B70", "lab/cell1")
    assert distance(found.transform(), TIP) < 1e-3
    assert rotation_angle(found.transform(), TIP) < np.radians(0.5)
    assert found.error_mm > 0.2, "not less than the noise of a touch explains, however well few points fit"
    said = json.loads(run(*words, "--json").stdout)
    assert said["version"] == 2
    assert said["error"] == pytest.approx(found.error_mm / 1000.0)


def test_mesh_refines_touched_points(tmp_path: Path) -> None:
    sphere = icosphere(subdivisions=4)
    mesh = Trimesh(np.asarray(sphere.vertices) * (60.0, 40.0, 20.0), sphere.faces, process=False)
    mesh.export(tmp_path / "coil.stl")
    vertices = np.asarray(mesh.vertices) / 1000.0
    surface = vertices[np.asarray(mesh.faces)].mean(axis=1)[::40]
    points = np.concatenate((vertices[[0, 40, 200, 900]], surface))
    file = touches_file(tmp_path, points, [True] * 4 + [False] * len(surface))
    output = tmp_path / "tip.toml"
    words = (file, "--pointer", pointer_file(tmp_path), "-o", str(output))
    noise = ("--noise-mm", "1", "--surface-mm", "0.1")
    ended = run("tip", "mesh", *words, *noise, "--mesh", str(tmp_path / "coil.stl"))
    assert ended.exit_code == 0, ended.output
    found = read_calibration(output)
    assert distance(found.transform(), TIP) < 0.2e-3
    assert found.error_mm < 0.2
    assert f"{len(surface)} on the mesh" in found.method


def pivot_files(folder: Path) -> list[str]:
    rng = np.random.default_rng(3)
    for name, height in (("tip", 0.0), ("end", 0.1)):
        turns = [Transform.from_rotvec((0.0, 0.0, 0.0), rng.uniform(-0.6, 0.6, 3)).rotation for _ in range(30)]
        at = TIP @ np.array((0.0, 0.0, height))
        poses = [Transform(turn, np.array((0.0, 0.0, 1.5)) - turn @ at + rng.normal(0.0, 5e-5, 3)) for turn in turns]
        write_poses(folder / f"{name}.csv", TIP_PIVOT, [poses])
    return [str(folder / "tip.csv"), str(folder / "end.csv")]


def test_pivots_write_the_tip_of_a_guide(tmp_path: Path) -> None:
    output = tmp_path / "guide.toml"
    ended = run("tip", "pivot", *pivot_files(tmp_path), "-o", str(output), "--any-cell")
    assert ended.exit_code == 0, ended.output
    found = read_calibration(output)
    assert (found.kind, found.type, found.cell) == ("tip", "drill_guide", "")
    assert distance(found.transform(), TIP) < 0.1e-3
    assert found.transform().rotation[:, 2] == pytest.approx(TIP.rotation[:, 2], abs=2e-3)
    assert 0.0 < found.error_mm < 0.2
    assert found.error_deg > 0.0


def test_values_of_the_maker_need_their_error(tmp_path: Path) -> None:
    output = tmp_path / "tip.toml"
    words = ("tip", "values", "--position-mm", "0", "-30", "-85", "--quat-wxyz", "0.8", "0.4", "0.2", "0.4")
    assert run(*words).exit_code == 2
    ended = run(*words, "--error-mm", "0.4", "--error-deg", "0.3", "-o", str(output), "--name", "MC-B70")
    assert ended.exit_code == 0, ended.output
    found = read_calibration(output)
    assert found.transform().translation == pytest.approx([0.0, -0.03, -0.085])
    assert (found.error_mm, found.error_deg) == pytest.approx((0.4, 0.3))
    assert found.method == "values of the maker"


def test_points_that_do_not_fit_or_determine_are_refused(tmp_path: Path) -> None:
    pointer, output = pointer_file(tmp_path), tmp_path / "tip.toml"
    for points, sigma, code in ((POINTS, 4e-3, "error_too_large"), (POINTS[:2], 0.0, "degenerate_points")):
        file = touches_file(tmp_path, points, [True] * len(points), sigma)
        ended = run("tip", "points", file, "--pointer", pointer, "-o", str(output), "--json")
        assert ended.exit_code == 1, ended.output
        assert json.loads(ended.stdout)["reason"]["code"] == code
    assert not output.exists()


def test_an_expired_pointer_touches_nothing(tmp_path: Path) -> None:
    file = touches_file(tmp_path, POINTS, [True] * 4)
    ended = run("tip", "points", file, "--pointer", pointer_file(tmp_path, days=200.0), "--json")
    assert ended.exit_code == 1
    assert json.loads(ended.stdout)["reason"]["code"] == "calibration_expired"


def test_a_tool_does_not_touch_as_a_pointer(tmp_path: Path) -> None:
    write_calibration(tmp_path / "coil.toml", a_tool())
    file = touches_file(tmp_path, POINTS, [True] * 4)
    ended = run("tip", "points", file, "--pointer", str(tmp_path / "coil.toml"))
    assert ended.exit_code == 5
    assert "not of a pointer" in ended.stderr


@pytest.mark.parametrize(
    ("before", "after", "words"),
    [
        (",50.000000,0.000000,10.000000", ",50.000000,,10.000000", "row 2"),
        (",50.000000,", ",inf,", "not finite"),
        (",50.000000,", ",50000,", "in mm"),
        (",50.000000,", ",five,", "row 2"),
    ],
)
def test_wrong_point_is_refused_with_its_row(tmp_path: Path, before: str, after: str, words: str) -> None:
    path = Path(touches_file(tmp_path, POINTS, [True] * 4))
    assert before in path.read_text()
    path.write_text(path.read_text().replace(before, after))
    with pytest.raises(FileFormatError, match=words):
        read_touches(path, TIP_IN_POINTER)
