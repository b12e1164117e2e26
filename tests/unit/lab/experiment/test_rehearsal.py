"""The dispatcher on a scripted tour: RATMS does as it must in every way, and one that does not is found out."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import pytest
import structlog
from click.testing import CliRunner

import pcmrs
from pcmrs.authoring.trial.coverage import Deviation, is_complete
from pcmrs.authoring.trial.tour import Tour, TourCommand, plan_tour
from pcmrs.cli import main
from pcmrs.fsm import Blueprint, load_blueprint
from pcmrs_lab.experiment.tours.rehearsal import LeapingClock, rehearse
from tests.support.altered import with_operation

RATMS = load_blueprint(Path(pcmrs.__file__).parent / "workflows" / "ratms.toml")


@pytest.fixture(autouse=True)
def steps_that_raise_are_not_logged() -> Iterator[None]:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    yield
    structlog.reset_defaults()


@cache
def tour() -> Tour:
    return plan_tour(RATMS)


async def rehearsed(blueprint: Blueprint, *, outside: bool = True) -> list[tuple[TourCommand, Deviation | None]]:
    return [judged async for judged in rehearse(blueprint, tour(), outside=outside)]


@pytest.mark.parametrize("outside", [True, False])
async def test_the_dispatcher_does_as_the_tour_says(outside: bool) -> None:
    done = await rehearsed(RATMS, outside=outside)
    assert [deviation for _, deviation in done if deviation is not None] == []
    assert {move for move, _ in done} == set(tour().wanted)


async def test_nothing_is_too_late_however_busy_the_machine_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pcmrs.dispatcher.command_checks.CHECKS_BEGIN_WITHIN", 0.0)
    assert [deviation for _, deviation in await rehearsed(RATMS) if deviation is not None] == []


@pytest.mark.parametrize(
    ("branch", "operation", "fields"),
    [
        ("placement", "approach", {"on_failure": "unknown"}),
        ("placement", "confirm", {"requires": {}, "from_": ["retracted", "standoff"]}),
        ("placement", "confirm", {"checks": []}),
        ("placement", "confirm", {"steps": ["follow_prepared"]}),
        ("registration", "digitized", {"iio": False}),
        ("robot", "link_lost", {"event": False}),
        ("registration", "plan_landmarks", {"to": "000"}),
    ],
)
async def test_a_dispatcher_that_runs_something_else_deviates(
    branch: str, operation: str, fields: dict[str, Any]
) -> None:
    done = await rehearsed(with_operation(RATMS, branch, operation, **fields))
    first = next(deviation for _, deviation in done if deviation is not None)
    assert first.command.startswith(f"{branch}.{operation}:")


async def too_late(clock: LeapingClock) -> None:
    async with clock.timeout(10.0):
        await clock.sleep(4.0)
        await clock.sleep(7.0)


async def test_a_deadline_that_is_leapt_over_has_passed() -> None:
    clock = LeapingClock()
    begin = clock.monotonic()
    async with clock.timeout(10.0):
        await clock.sleep(9.0)
    with pytest.raises(TimeoutError):
        await too_late(clock)
    assert clock.monotonic() - begin == 20.0


def test_the_command_reports_everything_covered(tmp_path: Path) -> None:
    file = tmp_path / "tour.jsonl"
    run = CliRunner().invoke(main, ["fsm", "test", "ratms", "--json", "-o", str(file)])
    assert run.exit_code == 0
    from pcmrs_lab.experiment.tours.report import TourReport

    report = msgspec.json.decode(run.stdout, type=TourReport)
    assert report.passed
    assert is_complete(report.coverage)
    assert report.joint_states == 39
    moves = [msgspec.json.decode(line, type=TourCommand) for line in file.read_bytes().splitlines()]
    assert moves == [move for stretch in tour().stretches for move in stretch]


def test_the_command_refuses_what_is_too_large() -> None:
    run = CliRunner().invoke(main, ["fsm", "test", "ratms", "--limit", "5"])
    assert run.exit_code == 2
    assert "over 5 joint states" in run.stderr
