"""Tours as they are reported: what counts as covered and passed, and which cells are never toured."""

from __future__ import annotations

import logging

import msgspec
import pytest
import structlog

from pcmrs.errors import BlueprintError, ConfigurationError
from pcmrs.fsm import Blueprint
from pcmrs.testing.rehearsal import rehearse
from pcmrs_lab.experiment.tours import run
from pcmrs_lab.experiment.tours.report import TourReport
from pcmrs_lab.experiment.tours.run import SUBJECTS, tour_scripted
from tests.support.altered import with_operation
from tests.unit.lab.blueprints import ratms, small
from tests.unit.lab.experiment.tours.dice_cell import DiceCell, toured


@pytest.fixture(autouse=True)
def steps_that_raise_are_not_logged() -> None:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))


async def scripted(blueprint: Blueprint) -> TourReport:
    report, _ = await tour_scripted(blueprint, 1000, lambda *_: None)
    return report


async def test_engine_and_dispatcher_make_every_move_of_a_tour() -> None:
    shown: list[tuple[int, int]] = []
    report, moves = await tour_scripted(small(), 1000, lambda *step: shown.append(step))
    assert report.passed
    assert report.subjects == dict.fromkeys(SUBJECTS, len(moves))
    assert all(count.covered == count.total for count in report.coverage.values())
    assert report.joint_states == len({move.before for move in moves})
    assert shown[-1] == (3 * len(moves), 3 * len(moves))


async def test_a_subject_that_deviates_covers_nothing_there(monkeypatch: pytest.MonkeyPatch) -> None:
    """A move counts as covered only if every subject made it as required."""
    other = with_operation(small(), "side", "withdraw", to="held")
    monkeypatch.setattr(run, "rehearse", lambda blueprint, tour, outside: rehearse(other, tour, outside=outside))
    report = await scripted(small())
    assert not report.passed
    assert report.deviations[SUBJECTS[0]] == []
    assert {each.command for name in SUBJECTS[1:] for each in report.deviations[name]} == {"side.withdraw:done"}
    assert report.coverage["accepted"].covered < report.coverage["accepted"].total
    assert report.coverage["rejected"].covered <= report.coverage["rejected"].total


async def test_too_many_joint_states_are_refused() -> None:
    with pytest.raises(BlueprintError, match="over 2 joint states"):
        await tour_scripted(small(), 2, lambda *_: None)


async def test_a_cell_with_another_workflow_is_refused() -> None:
    cell = DiceCell(msgspec.structs.replace(ratms(), hash="0" * 64))
    with pytest.raises(ConfigurationError, match="runs ratms"):
        await toured(cell)


async def test_a_cell_that_is_not_simulated_is_refused() -> None:
    cell = DiceCell(ratms())
    cell.simulated = False
    with pytest.raises(ConfigurationError, match="simulated"):
        await toured(cell)
    assert cell.dispatcher.snapshot().sequence == 1  # no command but the one that ends it
