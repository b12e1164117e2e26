"""`pcmrs calibrate pivot` on files."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.calibration import read_calibration
from tests.unit.cli.calibrate.calibrations import TIP, pivot_file, run


def test_pivot_prints_writes_and_draws(tmp_path: Path) -> None:
    file, output, plot = pivot_file(tmp_path, bad=(4, 9)), tmp_path / "stylus.toml", tmp_path / "stylus.png"
    ended = run("pivot", file, "-o", str(output), "--name", "stylus", "--serial", "17", "--plot", str(plot))
    assert ended.exit_code == 0, ended.output
    assert "pose 5, 10" in ended.stdout
    assert ended.stdout.count("bad") == 2
    assert "±" in ended.stdout
    calibration = read_calibration(output)
    assert calibration.transform().translation == pytest.approx(TIP, abs=1e-4)
    said = (calibration.kind, calibration.name, calibration.serial, calibration.cell, calibration.version)
    assert said == ("pointer", "stylus", "17", "lab/cell1", 1)
    assert 0.02 < calibration.error_mm < 0.2
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_unreadable_file_ends_with_5(tmp_path: Path) -> None:
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    for words in (["pivot", str(tmp_path / "none.csv")], ["hand-eye", str(tmp_path / "other.csv")]):
        ended = run(*words)
        assert ended.exit_code == 5
        assert len(ended.stderr.splitlines()) == 1
