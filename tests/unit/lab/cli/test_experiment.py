"""`pcmrs experiment` and `pcmrs demo`: exit statuses, saved reports and pictures, and what each command refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs_lab.experiment import failures, following, placements, speed
from pcmrs_lab.experiment.failures import FailureReport
from pcmrs_lab.experiment.placements import PlacementReport
from pcmrs_lab.experiment.setup import ExperimentSetup
from tests.unit.lab.experiment.example_reports import (
    FOLLOWED,
    failure,
    failure_report,
    following_report,
    placement_report,
)

AS_PUBLISHED = failure_report(failure(1, None, paper=None), failure(15, "111", paper="111", motion_refused=True))
OTHERWISE = failure_report(failure(1, None, paper=None), failure(15, None, paper="111"))


@pytest.fixture
def setups(monkeypatch: pytest.MonkeyPatch) -> list[ExperimentSetup]:
    """Setups of the experiments that were requested; each ends at once, with an example of its report."""
    requested: list[ExperimentSetup] = []

    async def place(setup: ExperimentSetup, trials: int) -> PlacementReport:
        requested.append(setup)
        return placement_report(setup.seed, trials, setup.workflow)

    async def fail(given: list[ExperimentSetup]) -> FailureReport:
        requested.extend(given)
        return AS_PUBLISHED if given[0].seed == 1 else OTHERWISE

    async def follow(setup: ExperimentSetup, _duration: float) -> Any:
        requested.append(setup)
        return following_report(), FOLLOWED

    monkeypatch.setattr(placements, "run_placements", place)
    monkeypatch.setattr(failures, "run_failures", fail)
    monkeypatch.setattr(following, "run_following", follow)
    monkeypatch.setattr(speed, "processor_share", lambda: 1.0)
    return requested


def experiment(*words: str) -> Result:
    return CliRunner().invoke(main, ["experiment", *words])


def test_a_report_is_printed_saved_and_drawn(
    setups: list[ExperimentSetup], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pcmrs.analysis.plots.save_png", lambda _, path: path.write_text("drawn"))
    report, table, plot = (tmp_path / name for name in ("report.json", "table.svg", "plot.png"))
    words = ("--trials", "3", "--report", str(report), "--table", str(table), "--plot", str(plot), "--json")
    ended = experiment("placements", *words)
    assert ended.exit_code == 0, ended.stderr
    assert json.loads(ended.stdout) == json.loads(report.read_bytes())
    assert len(json.loads(ended.stdout)["trials"]) == 3
    assert table.read_text().startswith("<svg")
    assert plot.read_text() == "drawn"


@pytest.mark.parametrize(("seed", "status"), [("1", 0), ("2", 1)])
def test_a_run_that_ended_otherwise_than_published_is_a_failure(
    setups: list[ExperimentSetup], seed: str, status: int
) -> None:
    ended = experiment("failures", "--seed", seed)
    assert ended.exit_code == status
    assert [setup.workflow for setup in setups] == ["ratms", "femoroplasty"], "all workflows of the paper by default"


def test_failures_of_one_workflow_are_those_of_its_plan(setups: list[ExperimentSetup]) -> None:
    assert experiment("failures", "--workflow", "femoroplasty").exit_code == 0
    assert [setup.workflow for setup in setups] == ["femoroplasty"]
    assert len(setups[0].plan.landmarks) > 3


def test_following_runs_in_real_time_unless_asked_otherwise(setups: list[ExperimentSetup]) -> None:
    assert experiment("following", "--json").exit_code == 0
    assert experiment("following", "--rate", "2", "--workflow", "femoroplasty").exit_code == 0
    assert [(setup.rate, setup.workflow) for setup in setups] == [(1.0, "ratms"), (2.0, "femoroplasty")]


def test_noise_of_a_data_sheet_is_set_before_own_settings(setups: list[ExperimentSetup]) -> None:
    own = ("--set", "sim.tracker.rate_hz=30")
    assert experiment("placements", "--drivers", "virtual", "--noise", "vicra", *own).exit_code == 0
    settings = setups[0].settings()
    assert "tracker.driver=ndi" in settings
    assert [each for each in settings if each.startswith("sim.tracker.rate_hz")] == [
        "sim.tracker.rate_hz=20",
        "sim.tracker.rate_hz=30",
    ]


def test_the_demo_says_that_it_is_no_medical_device(setups: list[ExperimentSetup]) -> None:
    ended = CliRunner().invoke(main, ["demo", "--seed", "3"])
    assert ended.exit_code == 0, ended.stderr
    assert "A simulated cell, 5 times as fast as real time; speed limits" in ended.stdout
    assert "Research software, not a medical device." in ended.stdout
    assert "mean ± sd, and max, of 12 placements" in ended.stdout
    virtual = CliRunner().invoke(main, ["demo", "--drivers", "virtual"])
    assert "in real time, behind a virtual KUKA cabinet and a virtual NDI tracker" in " ".join(virtual.stdout.split())


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("placements", "--workflow", "no_such"), "The paper has no experiment with workflow 'no_such'"),
        (("placements", "--trials", "1"), "1 is not in the range x>=2"),
        (("placements", "--plan", "/no/such/file"), "cannot be read"),
        (("failures", "--plan", "examples/ratms_plan.json"), "name it with --workflow"),
        (("failures", "--plot", "rates.png"), "give their number with --runs"),
        (("failures", "--runs", "1", "--set", "robot.wheels=4"), "wheels"),
        (("following", "--duration", "9"), "--duration"),
        (("following", "--duration", "nan"), "--duration"),
        (("thresholds", "--interval", "0.6"), "--interval"),
        (("hotspots", "--intensity", "49"), "--intensity"),
    ],
)
def test_bad_requests_are_refused_in_one_line(setups: list[ExperimentSetup], words: tuple[str, ...], text: str) -> None:
    ended = experiment(*words, "--json")
    assert ended.exit_code != 0
    assert isinstance(ended.exception, SystemExit)  # anything else would be a traceback
    assert (ended.stdout, setups) == ("", [])
    assert text in ended.stderr
