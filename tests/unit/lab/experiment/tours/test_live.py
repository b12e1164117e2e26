"""Live tours of a cell that is only a dispatcher and dice: all there is to see is seen, and what is wrong shows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from pcmrs.errors import UnknownOutcomeError
from pcmrs.messages import Verdict
from pcmrs_lab.experiment.tours import live
from pcmrs_lab.experiment.tours.progress import DECIDED_AT_ONCE
from pcmrs_lab.experiment.tours.report import TourReport
from tests.support.altered import with_operation
from tests.unit.lab.blueprints import ratms
from tests.unit.lab.experiment.tours.dice_cell import DiceCell, toured

ENDED_OTHERWISE = ("rejected", "failed", "unknown")
NOT_PROVOKED = {"placement.following_lost:done": 2, "placement.force_limit:done": 5, "placement.watching_lost:done": 2}
"""Events that no fault of the scene brings about, and in how many joint states they could come."""


def unaccepted(report: TourReport) -> dict[str, int]:
    """What should have been accepted and was not seen, in how many joint states."""
    found = (left for left in report.left if left.command.partition(":")[2] not in ENDED_OTHERWISE)
    return {left.command: left.joint_states for left in found}


@pytest.mark.nightly
async def test_everything_that_a_cell_can_show_is_seen() -> None:
    report = await toured(DiceCell(ratms()))
    assert report.passed
    assert report.deviations == {"cell": []}
    assert {left.reason for left in report.left} == {live.NEVER_SILENT, live.NO_FAULT}
    missing = {"pairs": 0, "accepted": sum(NOT_PROVOKED.values()), "outcomes": len(NOT_PROVOKED)}
    for key, count in missing.items():
        assert report.coverage[key].covered == report.coverage[key].total - count
    assert unaccepted(report) == NOT_PROVOKED
    assert report.stops > 100


class FirstAcknowledgement(DiceCell):
    """A cell that falls silent at the first acknowledgement."""

    named: Mapping[str, Any] | None = None

    async def call(self, name: str, arguments: Mapping[str, Any], *, id: str, timeout: float) -> Verdict:
        state = self.dispatcher.snapshot()
        if name == "robot.acknowledge" and state.latched:
            self.named = arguments
            assert state.stop.number > 0
            raise UnknownOutcomeError(f"Stop {state.stop.number}")
        return await super().call(name, arguments, id=id, timeout=timeout)


async def test_an_acknowledgement_names_the_stop_that_was_seen() -> None:
    cell = FirstAcknowledgement(ratms())
    with pytest.raises(UnknownOutcomeError) as silent:
        await toured(cell)
    assert cell.named is not None
    assert silent.value.text == f"Stop {cell.named['stop']}"


@pytest.mark.nightly
async def test_joint_states_that_do_not_come_by_themselves_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "REPORTED_WITHIN", 0.01)
    cell = DiceCell(ratms())
    cell.never_aligned()
    report = await toured(cell)
    assert not report.passed
    assert report.deviations == {"cell": []}
    left = {left.command: left.reason for left in report.left}
    assert left["alignment.within:done"] == live.NOT_REPORTED
    assert left["alignment.outside:done"] == live.NOT_REACHED
    assert report.coverage["pairs"].covered > report.coverage["pairs"].total * 0.9


@pytest.mark.nightly
async def test_command_decided_at_once_is_not_stopped() -> None:
    report = await toured(DiceCell(ratms(), outside=False, refusing=0.0))
    assert report.passed
    failing = {left.reason for left in report.left if left.command.endswith(":failed")}
    assert failing == {DECIDED_AT_ONCE}


@pytest.mark.parametrize(
    ("branch", "operation", "fields"),
    [
        ("placement", "home", {"to": "held"}),
        ("placement", "approach", {"on_failure": "unknown"}),
        ("registration", "clear_registration", {"from_": ["110", "111"]}),
        ("toolplan", "reinit", {"requires": {}}),
    ],
)
@pytest.mark.nightly
async def test_a_cell_that_runs_something_else_deviates(branch: str, operation: str, fields: dict[str, Any]) -> None:
    report = await toured(DiceCell(with_operation(ratms(), branch, operation, **fields)))
    assert not report.passed
    assert any(deviation.command.startswith(f"{branch}.{operation}") for deviation in report.deviations["cell"])


async def test_time_that_is_up_is_no_success() -> None:
    report = await toured(DiceCell(ratms()), seconds=0.0)
    assert not report.passed
    assert report.coverage["pairs"].covered == 0
    assert any(left.reason == live.OUT_OF_TIME for left in report.left)


@pytest.mark.nightly
async def test_operations_without_arguments_are_named() -> None:
    report = await toured(DiceCell(ratms()), {"landmarks": {}, "landmark_index": {}, "tool_pose": {}})
    missing = {left.command for left in report.left if "give nudge with --arguments" in left.reason}
    assert missing == {f"placement.nudge:{ending}" for ending in ("done", "failed", "rejected")}
    assert report.deviations == {"cell": []}
