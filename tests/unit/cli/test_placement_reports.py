"""Placements and pose logs as reports: in mm and degrees, with a dash for what cannot be known."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from rich.console import RenderableType

from pcmrs.analysis.placements import PlacementTrial
from pcmrs.cli.placement_reports import placements_report, placements_tables, pose_log_report, pose_log_table
from pcmrs.cli.tables import NARROWEST, Terminal
from pcmrs.formats.pose_file import Placement
from pcmrs.formats.pose_log import ROWS, PoseLog
from pcmrs.spatial import Transform


def trial(name: str, vector_mm: tuple[float, float, float], angle_deg: float) -> PlacementTrial:
    """A placement without standoff, with this error in the measured tool's axes."""
    measured = Transform.from_rotvec((0.1, 0.2, 0.3), (0.4, -1.0, 0.1))
    turned = Transform.from_rotvec((0.0, 0.0, 0.0), (0.0, math.radians(angle_deg), 0.0))
    shift = Transform(np.eye(3), -np.array(vector_mm) / 1000.0)
    return PlacementTrial(Placement(name=name, planned=measured @ shift @ turned.inverse(), measured=measured), 0.0)


def shown(table: RenderableType, capsys: pytest.CaptureFixture[str]) -> str:
    Terminal(width=NARROWEST).print(table)
    return capsys.readouterr().out


def test_lengths_are_mm_and_angles_degrees() -> None:
    report = placements_report(Path("trials"), [trial("a", (3.0, 0.0, 4.0), 2.0), trial("b", (0.0, 0.0, -1.0), 1.0)])
    first, second = report.trials
    assert first.translation_error_mm == pytest.approx(5.0)
    assert first.rotation_error_deg == pytest.approx(2.0)
    assert second.translation_error_mm == pytest.approx(1.0)
    assert np.linalg.norm(first.error_vector_mm) == pytest.approx(5.0)
    summary = report.translation_error_mm
    assert [summary.mean, summary.max] == pytest.approx([3.0, 5.0])
    assert summary.sd == pytest.approx(math.sqrt(8.0)), "of two values, n - 1"


def test_a_deviation_that_cannot_be_known_is_a_dash(capsys: pytest.CaptureFixture[str]) -> None:
    table = placements_tables(placements_report(Path("one"), [trial("[red]only", (0.0, 0.0, 1.0), 0.5)]))
    text = shown(table, capsys)
    assert "1  [red]only" in text, "brackets of a name are no markup"
    (line,) = [line.split() for line in text.splitlines() if "translation error" in line]
    assert line[-3:] == ["1.0000", "-", "1.0000"]


def test_a_log_without_whole_samples_has_no_agreement(capsys: pytest.CaptureFixture[str]) -> None:
    pose = Transform.from_rotvec((0.0, 0.0, -1.0), (0.1, 0.0, 0.0))
    poses: dict[str, list[Transform | None]] = {name: [pose, pose, pose] for name in ROWS}
    poses[ROWS[0]] = [None, None, None]
    report = pose_log_report(Path("log.csv"), PoseLog("log", poses))
    assert (report.samples, report.compared) == (3, 0)
    assert (report.max_deviation_mm, report.max_deviation_deg) == (None, None)
    assert report.tracks[0].missing == 3
    assert report.tracks[0].jitter_mm is None
    assert "No sample has all three rows" in shown(pose_log_table(report), capsys)
