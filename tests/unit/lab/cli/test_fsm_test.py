"""`pcmrs fsm test`: exit statuses, the file of commands, and options that only count for a running cell."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result

from pcmrs.authoring.trial.coverage import MEANINGS, CoverageCount, Deviation, is_complete
from pcmrs.authoring.trial.tour import TourCommand, plan_tour
from pcmrs.cli import main
from pcmrs_lab.cli.fsm_test import MOST_SHOWN
from pcmrs_lab.experiment import private
from pcmrs_lab.experiment.tours import run as tours
from pcmrs_lab.experiment.tours.report import Left, TourReport
from tests.unit.fsm.rules.small_workflow import SMALL
from tests.unit.lab.blueprints import small


@pytest.fixture
def workflow(tmp_path: Path) -> str:
    file = tmp_path / "small.toml"
    file.write_text(SMALL)
    return str(file)


def fsm_test(*words: str) -> Result:
    return CliRunner().invoke(main, ["fsm", "test", *words])


def report(deviations: int = 0, *, passed: bool = True) -> TourReport:
    found = [
        Deviation(command=f"a.b:{number}", before="here", expected="accepted", found="rejected")
        for number in range(deviations)
    ]
    return TourReport(
        workflow="small",
        version="1",
        hash="ab",
        subjects={"cell": 40},
        joint_states=5,
        stops=3,
        events=2,
        seconds=1.25,
        coverage={key: CoverageCount(4, 5) if key == "pairs" else CoverageCount(0, 0) for key in MEANINGS},
        deviations={"cell": found},
        left=[Left("a.b:failed", 2, "the time was up")],
        passed=passed,
    )


@pytest.fixture
def live(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Arguments with which cells were toured, and the settings of their daemons; each tour ends at once."""
    toured: list[Any] = []

    @asynccontextmanager
    async def bench(settings: Sequence[str]) -> AsyncIterator[Any]:
        toured.append(settings)
        yield SimpleNamespace(client=None)

    async def tour(*given: Any) -> Any:
        toured.append(given)
        return report(passed=False), []

    monkeypatch.setattr(private, "private_bench", bench)
    monkeypatch.setattr(tours, "tour_live", tour)
    return toured


def test_the_command_reports_everything_covered(workflow: str, tmp_path: Path) -> None:
    file = tmp_path / "tour.jsonl"
    ended = fsm_test(workflow, "--json", "-o", str(file))
    assert ended.exit_code == 0, ended.stderr
    found = msgspec.json.decode(ended.stdout, type=TourReport)
    assert found.passed
    assert is_complete(found.coverage)
    moves = [msgspec.json.decode(line, type=TourCommand) for line in file.read_bytes().splitlines()]
    assert moves == [move for stretch in plan_tour(small()).stretches for move in stretch]


def test_the_table_shows_subjects_and_what_there_is_to_cover(workflow: str) -> None:
    ended = fsm_test(workflow)
    assert ended.exit_code == 0
    assert ended.stdout.count("all as required") == 3
    assert "steps that leave doubt" in ended.stdout
    assert "refusing checks" not in ended.stdout, "this workflow has none"


def test_a_workflow_that_is_too_large_is_refused(workflow: str) -> None:
    ended = fsm_test(workflow, "--limit", "2")
    assert ended.exit_code == 5
    assert "over 2 joint states" in ended.stderr


@pytest.mark.parametrize(
    "words", [("--rate", "5"), ("--seed", "2"), ("--connect",), ("--time-limit", "9"), ("--cell", "c")]
)
def test_options_of_a_cell_need_a_cell(workflow: str, words: tuple[str, ...]) -> None:
    ended = fsm_test(workflow, *words)
    assert ended.exit_code == 2
    assert f"{words[0]} is for --live only" in ended.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("--rate", "nan"),
        ("--rate", "0"),
        ("--time-limit", "nan"),
        ("--time-limit", "-1"),
        ("--seed", "-1"),
        ("--limit", "0"),
    ],
)
def test_impossible_values_are_usage_errors(workflow: str, live: list[Any], words: tuple[str, ...]) -> None:
    """A time limit that is not a number would end a tour before its first command."""
    ended = fsm_test(workflow, "--live", *words)
    assert (ended.exit_code, live) == (2, [])
    assert words[0] in ended.stderr


def test_a_separate_daemon_runs_the_file_with_the_given_settings(
    workflow: str, live: list[Any], tmp_path: Path
) -> None:
    arguments = tmp_path / "arguments.toml"
    arguments.write_text("press = { force = 4.5 }\n")
    words = ("--live", "--rate", "3", "--seed", "9", "--set", "cell.name=x", "--time-limit", "7")
    ended = fsm_test(workflow, *words, "--arguments", str(arguments))
    assert ended.exit_code == 1, "something was not covered"
    settings, (blueprint, _client, given, limit, seconds, _progress) = live
    assert [settings[0], settings[1], settings[-1]] == [f"workflow={workflow}", "sim.seed=9", "cell.name=x"]
    assert (blueprint.id, limit, seconds) == ("small", 5000, 7.0)
    assert given.next("a.press", "press") == {"force": 4.5}, "the file counts before the example plan"
    assert given.next("a.nudge", "nudge"), "payloads that the file does not name have those of the plan"


def test_what_was_not_covered_is_listed_with_its_reason(workflow: str, live: list[Any]) -> None:
    ended = fsm_test(workflow, "--live")
    assert "not covered (2×): a.b:failed: the time was up" in ended.stdout
    assert "3 stops, 2 events of devices by themselves" in ended.stdout


def test_only_so_many_deviations_are_printed(workflow: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def tour(*_: Any) -> Any:
        return report(MOST_SHOWN + 5, passed=False), []

    monkeypatch.setattr(tours, "tour_scripted", tour)
    ended = fsm_test(workflow)
    assert ended.exit_code == 1
    assert f"cell: 40 commands, {MOST_SHOWN + 5} deviate" in ended.stdout
    assert ended.stdout.count("expected accepted, found rejected") == MOST_SHOWN
