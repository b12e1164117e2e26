"""A calibration is written with its version, or refused and not written."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pcmrs.calibration import read_calibration
from tests.unit.cli.calibrate.calibrations import TIP, pivot_file, run


def test_calibrating_again_makes_the_next_version(tmp_path: Path) -> None:
    words = ("pivot", pivot_file(tmp_path), "-o", str(tmp_path / "stylus.toml"), "--json", "--any-cell")
    for version in (1, 2):
        said = json.loads(run(*words).stdout)
        assert said["accepted"]
        assert said["version"] == version
        assert said["tip_in_pointer"] == pytest.approx(TIP, abs=1e-4)
    calibration = read_calibration(tmp_path / "stylus.toml")
    assert (calibration.sha256, calibration.cell) == (said["sha256"], "")
    other = run(*words, "--name", "another")
    assert other.exit_code == 5
    assert "another tool or pointer" in other.stderr


@pytest.mark.parametrize(
    ("words", "code"), [(("--limit-mm", "0.001"), "error_too_large"), ((), "degenerate_motion")], ids=["limit", "still"]
)
def test_insufficient_calibration_is_refused_and_not_written(tmp_path: Path, words: tuple[str, ...], code: str) -> None:
    file, output = pivot_file(tmp_path, tilt=0.6 if words else 0.01), tmp_path / "stylus.toml"
    ended = run("pivot", file, "-o", str(output), "--json", *words)
    assert ended.exit_code == 1
    assert json.loads(ended.stdout)["reason"]["code"] == code
    (line,) = ended.stderr.splitlines()
    assert line.startswith("main calibrate pivot: ")
    assert not output.exists()
    if words:
        assert "rms residual" in run("pivot", file, *words).stdout
