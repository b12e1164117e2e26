"""`pcmrs data export`: a recorded procedure as the lab's files, which give what the journal says."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcmrs.calibration.lab_frames import read_lab_calibrations
from pcmrs.formats.lab_files import CALIBRATIONS, PROCEDURE, find_lab_files, read_lab_procedure
from pcmrs.spatial import distance
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import CalibrationSettings
from tests.unit.cli.command_line import run
from tests.unit.report.report_journals import Row, golden_rows, write_journal


def export(folder: Path, *more: str) -> list[str]:
    words = ("data", "export", "--format", "rotms", str(folder / "lab"), "--set", f"cell.folder={folder / 'cell'}")
    ended = run(*words, "--json", *more)
    assert ended.exit_code == 0, ended.stderr
    files: list[str] = json.loads(ended.stdout)["files"]
    return files


@pytest.fixture
def rows() -> list[Row]:
    """Rows of one run of the daemon, with a registration and a plan."""
    found = golden_rows("ratms")
    return [row for row in found if row["session_id"] == found[0]["session_id"]]


def last(rows: list[Row], field: str) -> dict[str, Any]:
    found: dict[str, Any] = next(row["result"][field] for row in reversed(rows) if (row.get("result") or {}).get(field))
    return found


def test_a_recorded_procedure_gives_the_residual_of_the_journal(tmp_path: Path, rows: list[Row]) -> None:
    write_journal(rows, tmp_path / "cell" / "ratms.sqlite")
    assert set(export(tmp_path)) >= {
        "landmarkplan.yaml",
        "landmarkdig.yaml",
        "reg.yaml",
        "toolpose.yaml",
        *CALIBRATIONS,
    }
    found = read_lab_procedure(find_lab_files(tmp_path / "lab", PROCEDURE))
    registered = last(rows, "previous")
    assert found.registration is not None
    mapped = np.array([found.registration @ np.array(point) for point in found.planned])
    distances = np.linalg.norm(mapped - np.array(found.digitized, dtype=float), axis=1)
    assert distances.mean() == pytest.approx(registered["residual"], rel=1e-9)
    assert len(found.planned) == 6
    assert found.refined == bool(registered.get("covariance"))
    assert found.tool_pose is not None
    np.testing.assert_allclose(found.tool_pose.translation, last(rows, "previous_plan")["image_from_coil"]["position"])


def test_the_calibrations_of_the_cell_are_exported(tmp_path: Path) -> None:
    assert sorted(export(tmp_path)) == sorted(CALIBRATIONS)
    found = read_lab_calibrations(find_lab_files(tmp_path / "lab", CALIBRATIONS))
    mounting = Mounting.read(CalibrationSettings())
    assert distance(found.flange_from_tool_marker, mounting.flange_from_tool_marker) < 1e-12
    assert distance(found.tool_marker_from_tool_tip, mounting.tool_marker_from_tool_tip) < 1e-12
    assert found.standoff == pytest.approx(0.07)


def test_an_earlier_session_of_another_patient_is_not_mixed_in(tmp_path: Path, rows: list[Row]) -> None:
    later = [row for row in json.loads(json.dumps(rows)) if (row.get("result") or {}).get("landmarks")][:1]
    later[0] |= {"session_id": "another", "command_id": "another"}
    write_journal([*rows, *later], tmp_path / "cell" / "ratms.sqlite")
    files = export(tmp_path)
    assert "landmarkplan.yaml" in files
    assert not {"landmarkdig.yaml", "reg.yaml", "toolpose.yaml"} & set(files)


def test_a_folder_in_use_stays_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "lab").mkdir()
    (tmp_path / "lab" / "reg.yaml").write_text("mine")
    ended = run("data", "export", "--format", "rotms", str(tmp_path / "lab"), "--set", f"cell.folder={tmp_path}")
    assert ended.exit_code == 4
    assert [(path.name, path.read_text()) for path in (tmp_path / "lab").iterdir()] == [("reg.yaml", "mine")]
