"""--workers, --cluster and --finished: what each command does with them, and what it refuses in one line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from pcmrs.cli import main

THRESHOLDS = ("experiment", "thresholds", "--subjects", "3")


@pytest.mark.parametrize(
    ("words", "status", "said"),
    [
        ((*THRESHOLDS, "--workers", "0"), 2, "--workers"),
        ((*THRESHOLDS, "--workers", "2", "--cluster", "tls://scheduler:8786"), 2, "leave it out"),
        ((*THRESHOLDS, "--cluster", "tcp://192.0.2.1:8786"), 4, "is neither encrypted nor on this machine"),
        ((*THRESHOLDS, "--finished", "/no/such/folder/file.jsonl"), 5, "No such file or directory"),
        (("faults", "explore", "--cluster", "tcp://192.0.2.1:8786"), 4, "neither encrypted"),
        (("faults", "run", "--id", "S1", "--cluster", "192.0.2.1:8786"), 4, "write tls://HOST:PORT"),
        (("experiment", "failures", "--workers", "2"), 2, "--runs"),
        (("experiment", "placements", "--workers", "2"), 2, "--seeds"),
    ],
)
def test_bad_requests_are_refused_in_one_line(words: tuple[str, ...], status: int, said: str) -> None:
    ended = CliRunner().invoke(main, words)
    assert (ended.exit_code, ended.stdout) == (status, ""), ended.stderr
    assert said in " ".join(ended.stderr.split())
    assert isinstance(ended.exception, SystemExit)


def test_a_second_run_takes_everything_from_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = [*THRESHOLDS, "--json", "--finished", str(tmp_path / "finished.jsonl")]
    first = CliRunner().invoke(main, words)
    monkeypatch.setattr("pcmrs_lab.experiment.thresholds.draw", None)
    again = CliRunner().invoke(main, words)
    assert (first.exit_code, again.exit_code) == (0, 0), again.stderr
    assert json.loads(first.stdout) == json.loads(again.stdout)
    assert len((tmp_path / "finished.jsonl").read_bytes().splitlines()) == 3
