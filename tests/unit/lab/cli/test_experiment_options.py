"""Options that all experiments share: what they become, and what they refuse before anything is started."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from pcmrs.cli import main
from pcmrs.cli.running import readable_errors
from pcmrs.errors import ConfigurationError
from pcmrs.testing.plan import example_plan
from pcmrs_lab.cli.experiment_options import ExperimentOptions, experiment_options
from pcmrs_lab.experiment import speed


@pytest.fixture(autouse=True)
def share(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Share of a processor that the machine has left; a test may change it."""
    free = [1.0]
    monkeypatch.setattr(speed, "processor_share", lambda: free[0])
    return free


def given(*words: str, workflow: str | None = "ratms", rate: float = 5.0) -> tuple[Result, list[dict[str, Any]]]:
    taken: list[dict[str, Any]] = []

    @click.command()
    @experiment_options(workflow, rate)
    @click.option("--own")
    @readable_errors
    def command(**options: Any) -> None:
        taken.append(options)

    return CliRunner().invoke(command, words), taken


def options_of(*words: str, **defaults: Any) -> ExperimentOptions:
    ended, taken = given(*words, **defaults)
    assert ended.exit_code == 0, ended.stderr
    options = taken[0]["options"]
    assert isinstance(options, ExperimentOptions)
    return options


def test_shared_options_come_as_one_and_own_ones_beside() -> None:
    ended, taken = given("--own", "x", "--set", "a=1", "--set", "b=2", "--seed", "3", "--report", "r.json")
    assert ended.exit_code == 0
    assert taken[0].keys() == {"options", "own"}
    options = taken[0]["options"]
    assert (options.overrides, options.seed, options.report_file) == (("a=1", "b=2"), 3, Path("r.json"))
    assert (options.workflow, options.drivers, options.rate) == ("ratms", "builtin", 5.0)


def test_a_busy_machine_runs_at_a_lower_rate_and_says_so(share: list[float]) -> None:
    share[0] = 0.3
    ended, taken = given()
    assert taken[0]["options"].rate == 2.0
    assert "The machine is busy" in ended.stderr
    assert ended.stdout == ""


def test_real_time_needs_no_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "processor_share", None)
    assert options_of(rate=1.0).rate == 1.0
    assert options_of("--rate", "0.5").rate == 0.5


def test_virtual_drivers_run_in_real_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "processor_share", None)
    assert options_of("--drivers", "virtual").rate == 1.0
    assert options_of("--drivers", "virtual", "--rate", "1").rate == 1.0


@pytest.mark.parametrize("command", [("demo",), ("experiment", "placements"), ("experiment", "failures")])
def test_virtual_devices_run_in_real_time_only(command: tuple[str, ...]) -> None:
    ended = CliRunner().invoke(main, [*command, "--drivers", "virtual", "--rate", "5"])
    assert ended.exit_code == 2
    assert "--drivers virtual runs in real time: leave out --rate 5." in ended.stderr


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--rate", "nan"), "not finite"),
        (("--rate", "0"), "--rate"),
        (("--seed", "-1"), "--seed"),
        (("--drivers", "real"), "--drivers"),
        (("--report", "/no/such/folder/r.json"), "cannot be written"),
        (("--table", "/no/such/folder/p.svg"), "cannot be written"),
    ],
)
def test_impossible_values_are_usage_errors(words: tuple[str, ...], text: str) -> None:
    ended, taken = given(*words)
    assert (ended.exit_code, taken) == (2, [])
    assert text in ended.stderr


def test_an_unknown_workflow_is_refused_by_its_name() -> None:
    """Not because its plan is missing."""
    with pytest.raises(ConfigurationError, match="no experiment with workflow 'biopsy'"):
        options_of().setup("biopsy", lambda *_: None)


def test_a_given_plan_counts_for_any_workflow() -> None:
    setup = options_of("--plan", str(example_plan("ratms"))).setup("biopsy", lambda *_: None)
    assert (setup.workflow, len(setup.plan.poses) > 0) == ("biopsy", True)


def test_a_plan_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="cannot be read"):
        options_of("--plan", str(tmp_path / "none.json")).setup("ratms", lambda *_: None)


def test_asking_for_help_measures_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(speed, "processor_share", None)
    ended, taken = given("--help")
    assert (ended.exit_code, taken) == (0, [])
    assert "1 with virtual drivers" in ended.output
