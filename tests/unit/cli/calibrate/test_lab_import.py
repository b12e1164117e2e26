"""`pcmrs calibrate import`: a cell that starts with the lab's calibrations, or nothing."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pcmrs.calibration import read_calibration
from pcmrs.formats.landmarks import pair_landmarks, read_landmarks
from pcmrs.settings import read_settings
from pcmrs.spatial import distance
from pcmrs.testing.plan import read_plan
from pcmrs.workflows.mounting import Mounting
from tests.unit.cli.calibrate.calibrations import run
from tests.unit.formats.lab_folder import (
    DIGITIZED,
    PLANNED,
    PTR_PTRTIP,
    REG,
    TOOL_POSE,
    TOOLREF_EFF,
    make_lab_folder,
    pose_text,
)

ERRORS = ("--tool-error", "0.5", "0.2", "--tip-error", "0.4", "0.1", "--pointer-error", "0.3", "--date", "2026-10-01")


def lab_import(folder: Path, *more: str) -> tuple[int, str, str]:
    ended = run("import", str(folder / "lab"), "-o", str(folder / "out"), *ERRORS, *more)
    return ended.exit_code, ended.stdout, ended.stderr


def test_a_cell_reads_the_imported_calibrations(tmp_path: Path) -> None:
    make_lab_folder(tmp_path / "lab")
    status, said, _ = lab_import(tmp_path, "--name", "MC-B70", "--serial", "17")
    assert status == 0, said
    settings = read_settings(tmp_path / "out" / "cell.toml")
    mounting = Mounting.read(settings.procedure.calibration)
    assert distance(mounting.flange_from_tool_marker, TOOLREF_EFF.inverse()) < 1e-9
    assert distance(mounting.pointer_from_tip, PTR_PTRTIP) < 1e-9
    assert settings.procedure.placement.standoff == pytest.approx(0.07)
    tip = read_calibration(tmp_path / "out" / "tip.toml")
    assert (tip.name, tip.serial, tip.error_mm, tip.error_deg, tip.cell) == ("MC-B70", "17", 0.4, 0.1, "lab/cell1")
    assert f"{tip.date:%Y-%m-%d}" == "2026-10-01"
    assert "the lab's registration brings the landmarks together within 1.00 mm on average" in said


def test_the_last_procedure_becomes_files_of_our_commands(tmp_path: Path) -> None:
    make_lab_folder(tmp_path / "lab")
    status, said, _ = lab_import(tmp_path, "--json")
    assert status == 0, said
    told = json.loads(said)
    assert told["landmark_distance_mm"] == pytest.approx(1.0, abs=1e-6)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(told["files"])
    pairs = pair_landmarks(
        read_landmarks(tmp_path / "out" / "plan.json"), read_landmarks(tmp_path / "out" / "digitized.csv")
    )
    assert pairs.matched_by == "name"
    np.testing.assert_allclose(pairs.planned, PLANNED, atol=1e-12)
    np.testing.assert_allclose(pairs.digitized, DIGITIZED, atol=1e-12)
    assert len(read_landmarks(tmp_path / "out" / "surface.csv").names) == 4
    (pose,) = read_plan(tmp_path / "out" / "plan.json").poses
    np.testing.assert_allclose(pose.position, TOOL_POSE.translation, atol=1e-12)


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({"reg": "TRANSLATION: {x: 1}\n"}, "reg.yaml in line 1 needs x, y, z"),
        ({"icpdig": 'points0: "1,2,"\n'}, "icpdig.yaml in line 1 holds 2 numbers"),
        ({"cntct_offset": None}, "cntct_offset.yaml is not there"),
        ({"reg": pose_text(REG.inverse())}, "the files are of two sessions"),
    ],
    ids=["wrong pose", "cut cloud", "missing", "inverse registration"],
)
def test_one_bad_file_leaves_nothing_behind(tmp_path: Path, changed: dict[str, str | None], reason: str) -> None:
    make_lab_folder(tmp_path / "lab", **changed)
    status, _, problem = lab_import(tmp_path)
    assert status == 5
    assert reason in problem
    assert [path.name for path in tmp_path.iterdir()] == ["lab"]


def test_calibrations_alone_do_not_need_a_good_procedure(tmp_path: Path) -> None:
    make_lab_folder(tmp_path / "lab", reg="", landmarkdig="DIGITIZED: 5\n")
    assert lab_import(tmp_path, "--calibration-only")[0] == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "cell.toml",
        "pointer.toml",
        "tip.toml",
        "tool.toml",
    ]


def test_an_output_folder_in_use_stays_as_it_is(tmp_path: Path) -> None:
    make_lab_folder(tmp_path / "lab")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    status, _, problem = lab_import(tmp_path)
    assert status == 4
    assert "not empty" in problem
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]


def test_a_calibration_of_tomorrow_is_refused(tmp_path: Path) -> None:
    make_lab_folder(tmp_path / "lab")
    ended = run("import", str(tmp_path / "lab"), "-o", str(tmp_path / "out"), *ERRORS[:-1], "2999-01-01")
    assert ended.exit_code == 2
    assert "in the future" in ended.stderr
