"""The placement experiment over several seeds, with the single experiment replaced; a real one is at the end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs.errors import CommandRefusedError
from pcmrs_lab.experiment import placement_seeds
from pcmrs_lab.experiment.placements import PlacementReport
from pcmrs_lab.experiment.setup import ExperimentSetup
from tests.unit.lab.experiment.example_reports import placement_report

REFUSED_SEED = 6


async def _measured(setup: ExperimentSetup, trials: int) -> PlacementReport:
    setup.progress("placing", 1, trials)
    if setup.seed == REFUSED_SEED:
        raise CommandRefusedError("registration.register was rejected: the residual is too large.")
    return placement_report(setup.seed, trials, setup.workflow)


def _run(monkeypatch: pytest.MonkeyPatch, *words: str) -> Result:
    monkeypatch.setattr(placement_seeds, "run_placements", _measured)
    return CliRunner().invoke(main, ["experiment", "placements", *words])


def test_seeds_are_pooled_over_all_their_placements(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file, plot = tmp_path / "report.json", tmp_path / "seeds.png"
    words = ("--seeds", "3", "--seed", "2", "--trials", "4", "--json", "--report", str(file), "--plot", str(plot))
    ended = _run(monkeypatch, *words)
    assert ended.exit_code == 0, ended.stderr
    report = json.loads(ended.stdout)
    assert report == json.loads(file.read_bytes())
    assert [run["seed"] for run in report["runs"]] == [2, 3, 4]
    errors = np.array([trial["translation_error_mm"] for run in report["runs"] for trial in run["report"]["trials"]])
    assert len(errors) == report["pooled"]["trials"] == 12
    pooled = report["pooled"]["translation_error_mm"]
    assert pooled == {"mean": pytest.approx(errors.mean()), "sd": pytest.approx(errors.std(ddof=1)), "max": 4.4}
    assert report["pooled"]["true_translation_error_mm"]["max"] == pytest.approx(8.8)
    assert report["simulated"] is True
    assert plot.read_bytes().startswith(b"\x89PNG")


def test_a_refused_seed_is_reported_and_the_others_count(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    plot = tmp_path / "seeds.png"
    ended = _run(monkeypatch, "--seeds", "2", "--seed", "5", "--trials", "2", "--plot", str(plot))
    assert ended.exit_code == 1
    assert "Seed 6 was refused: registration.register was rejected" in " ".join(ended.stdout.split())
    assert "5.150 ± 0.071" in ended.stdout
    assert plot.exists()


def test_where_every_seed_is_refused_nothing_is_pooled(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(placement_seeds, "summary_of", None)  # there is nothing to sum up

    async def refuse(setup: ExperimentSetup, trials: int) -> PlacementReport:
        raise CommandRefusedError("refused")

    monkeypatch.setattr(placement_seeds, "run_placements", refuse)
    words = ["experiment", "placements", "--seeds", "2", "--json", "--plot", str(tmp_path / "none.png")]
    ended = CliRunner().invoke(main, words)
    assert ended.exit_code == 1
    assert json.loads(ended.stdout)["pooled"] is None
    assert not (tmp_path / "none.png").exists()


def test_a_number_of_seeds_below_one_is_a_usage_error() -> None:
    ended = CliRunner().invoke(main, ["experiment", "placements", "--seeds", "0"])
    assert ended.exit_code == 2
    assert "--seeds" in ended.stderr


@pytest.mark.nightly
def test_two_seeds_of_the_simulated_cell(tmp_path: Path) -> None:
    plot = tmp_path / "seeds.png"
    words = ["experiment", "placements", "--seeds", "2", "--trials", "2", "--json", "--plot", str(plot)]
    ended = CliRunner().invoke(main, words)
    assert ended.exit_code == 0, ended.stderr
    first, second = json.loads(ended.stdout)["runs"]
    assert first["report"]["residual_mm"] != second["report"]["residual_mm"]
    assert plot.read_bytes().startswith(b"\x89PNG")
