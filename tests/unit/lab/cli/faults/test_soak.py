"""`pcmrs faults soak`: what grew is said so, in the units of its measure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs_lab.campaign import soak_plot, soaking
from pcmrs_lab.campaign.soaking import ResourceTrend, SoakReport

FLAT = ResourceTrend("daemon", "threads", [0.0, 60.0], [12.0, 13.0], 1.0, 0.1)
GROWING = ResourceTrend("node", "memory", [0.0, 60.0], [1e8, 1.5e8], 5e7, 1e6)


def report(*courses: ResourceTrend, ended: str = "") -> SoakReport:
    return SoakReport(5400.0, 1, 100, 5, {"accepted": 90}, 300, ended, list(courses))


def soak(monkeypatch: pytest.MonkeyPatch, given: SoakReport, *words: str) -> Result:
    async def run(hours: float, seed: int, folder: Path, _clock: Any, *, progress: Any) -> SoakReport:
        return given

    monkeypatch.setattr(soaking, "soak", run)
    return CliRunner().invoke(main, ["faults", "soak", *words])


def test_a_measure_that_grows_is_a_failure_in_megabytes(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = soak(monkeypatch, report(FLAT, GROWING))
    assert ended.exit_code == 1
    lines = [" ".join(line.split()) for line in ended.stdout.splitlines()]
    assert "node memory 100.0 MB 150.0 MB 50.0 MB GROWS" in lines
    assert "daemon threads 12.0 13.0 1.0 flat" in lines
    assert "100 commands, 5 of them Stop, in 1.50 h." in " ".join(ended.stdout.split())


def test_flat_measures_are_drawn_where_that_is_asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    drawn: list[Any] = []
    monkeypatch.setattr(soak_plot, "draw_soak", lambda *given: drawn.append(given))
    ended = soak(monkeypatch, report(FLAT), "--plot", str(tmp_path / "soak.png"), "--json")
    assert ended.exit_code == 0, ended.stderr
    assert json.loads(ended.stdout)["reports"][0]["violated"] is False
    assert drawn == [(report(FLAT), tmp_path / "soak.png")]


def test_an_early_end_is_a_failure_and_its_text_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    """A text with brackets is no style of the title."""
    ended = soak(monkeypatch, report(FLAT, ended="The daemon [/tmp/x] does not answer."))
    assert ended.exit_code == 1, ended.exception
    assert "The daemon [/tmp/x] does not answer." in " ".join(ended.stdout.split())


@pytest.mark.parametrize("words", [("--hours", "0"), ("--hours", "nan"), ("--plot", "/no/such/soak.png")])
def test_impossible_requests_are_usage_errors(monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]) -> None:
    assert soak(monkeypatch, report(), *words).exit_code == 2
