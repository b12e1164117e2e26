"""`pcmrs experiment failures --runs N`: rates over simulated touches, without a daemon."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from pcmrs.cli import main
from pcmrs.errors import ConfigurationError
from pcmrs.testing.plan import example_plan, read_plan
from pcmrs_lab.experiment.monte_carlo import MonteCarloReport, run_monte_carlo
from pcmrs_lab.experiment.published import PUBLISHED
from pcmrs_lab.experiment.setup import ExperimentSetup


def setups(*overrides: str, seed: int = 1) -> list[ExperimentSetup]:
    return [
        ExperimentSetup(
            read_plan(example_plan(workflow)),
            workflow,
            seed,
            1.0,
            "builtin",
            overrides,
            lambda _text, _done, _total: None,
        )
        for workflow in PUBLISHED
    ]


def rate(report: MonteCarloReport, workflow: str, gate: str) -> tuple[float, float]:
    (found,) = [rates for rates in report.rates if (rates.workflow, rates.gate) == (workflow, gate)]
    return found.false_rejects, found.false_accepts


@pytest.fixture(scope="module")
def report() -> MonteCarloReport:
    return run_monte_carlo(setups(), 100)


def test_every_published_row_is_there_and_separated(report: MonteCarloReport) -> None:
    assert [row.run for row in report.rows] == list(range(1, 21))
    for row in report.rows:
        (paper,) = [run for run in PUBLISHED[row.workflow].failures if run.run == row.run]
        assert row.published_residual_mm == paper.residual_mm
        if paper.injection == "none":
            assert row.refused <= 7  # 100 runs at 1.1 % are 1.1; more than 7 have a probability of 0.001 %
        else:
            assert row.refused == row.runs == 100


@pytest.mark.parametrize("workflow", PUBLISHED)
def test_rates_of_each_gate(report: MonteCarloReport, workflow: str) -> None:
    for gate in ("verdict", "fixed_limit", "landmark_outlier", "residual_too_large"):
        false_rejects, false_accepts = rate(report, workflow, gate)
        assert false_rejects < 0.04
        assert false_accepts == 0.0
    for gate in ("wrong_unit", "mirrored", "swapped_landmarks", "tre_too_large"):
        assert rate(report, workflow, gate) == (0.0, 1.0)  # not what these are for, and no false alarm


def test_missing_landmarks_are_refused_but_not_counted_as_found(report: MonteCarloReport) -> None:
    """They are refused by construction."""
    missing = [row for row in report.rows if row.by_construction]
    assert [row.run for row in missing] == [7, 8, 9, 10, 11, 12, 13, 14]
    assert all((row.refused_by, row.residual_mm, row.named) == ({}, None, None) for row in missing)


def test_controls_have_the_residuals_of_the_paper(report: MonteCarloReport) -> None:
    for row in report.rows:
        if row.injection == "none" and row.residual_mm is not None and row.residual_mm.sd is not None:
            assert row.published_residual_mm is not None
            assert abs(row.residual_mm.mean - row.published_residual_mm) < row.residual_mm.sd


def test_one_seed_gives_one_result_and_settings_count() -> None:
    first, again, other = run_monte_carlo(setups(), 5), run_monte_carlo(setups(), 5), run_monte_carlo(setups(seed=2), 5)
    assert first == again
    assert [row.residual_mm for row in first.rows] != [row.residual_mm for row in other.rows]
    noisy = run_monte_carlo(setups("sim.digitization.noise_mm=6"), 5)
    assert (noisy.noise["ratms"].noise_mm, noisy.noise["ratms"].sigma_mm) == (6.0, 1.86)
    assert rate(noisy, "ratms", "fixed_limit")[0] > 0.5
    assert rate(noisy, "ratms", "landmark_outlier")[0] > 0.5  # more than the verdict expects
    limited = run_monte_carlo(setups("procedure.registration.tre_limit_mm=0.5"), 5)
    assert rate(limited, "femoroplasty", "tre_too_large") == (1.0, 0.0)
    with pytest.raises(ConfigurationError, match="residual_limit"):
        run_monte_carlo(setups("procedure.registration.residual_limit_mm=-1"), 5)


def test_the_command_prints_saves_and_draws(tmp_path: Path) -> None:
    report_file, picture, table = (tmp_path / f"rates.{ending}" for ending in ("json", "png", "svg"))
    words = ["experiment", "failures", "--runs", "3", "--workflow", "ratms", "--seed", "4"]
    ended = CliRunner().invoke(main, [*words, "--report", str(report_file), "--plot", str(picture)])
    assert ended.exit_code == 0, ended.stderr
    assert "by construction" in ended.stdout
    assert picture.read_bytes().startswith(b"\x89PNG")
    saved: dict[str, Any] = json.loads(report_file.read_text())
    printed = json.loads(CliRunner().invoke(main, [*words, "--json", "--table", str(table)]).stdout)
    assert printed == saved
    assert table.read_text().startswith("<svg")
    assert (saved["seed"], saved["runs"], saved["simulated"], len(saved["rows"])) == (4, 3, True, 10)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--runs", "0"), "range"),
        (("--plot", "x.png"), "--runs"),
        (("--runs", "2", "--set", "no.such=1"), "no"),
        (("--runs", "2", "--seed", "-1"), "--seed"),
        (("--runs", "2", "--rate", "nan"), "not finite"),
    ],
)
def test_bad_requests_are_refused_in_one_line(words: tuple[str, ...], said: str) -> None:
    ended = CliRunner().invoke(main, ["experiment", "failures", *words])
    assert ended.exit_code != 0
    assert isinstance(ended.exception, SystemExit)
    assert ended.stdout == ""
    assert said in ended.stderr
