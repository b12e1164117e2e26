"""The checks of a campaign can fail: what a cell does wrong is found, whatever it says of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, cast

import msgspec
import pytest

from pcmrs.journal import JournalRow
from pcmrs.messages import BlueprintTag, Reason, Running, Snapshot, Verdict
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.checks import confirmed, expect, held, refused, refused_at_edge, reported
from tests.unit.lab.campaign.faults.operated import OperatedCell, run
from tests.unit.lab.campaign.faults.scripted_raw import ScriptedRaw

SNAPSHOT = Snapshot(
    sequence=7,
    branches={"placement": "standoff"},
    flags={},
    running=[],
    latched=False,
    blueprint=BlueprintTag(id="ratms", version="1", hash="0"),
)
REJECTED = Verdict(
    id="1",
    branch="placement",
    operation="confirm",
    decision="rejected",
    state="standoff",
    sequence=7,
    reason=Reason(code="pose_stale", text="The pose is old."),
)


@dataclass
class ScriptedCell:
    """A cell that answers as told: it stands for client and cell at once."""

    verdict: Verdict = REJECTED
    after: Snapshot = SNAPSHOT
    recorded: list[Verdict] = field(default_factory=lambda: [REJECTED])
    asked: int = 0

    @property
    def client(self) -> ScriptedCell:
        return self

    async def state(self) -> Snapshot:
        self.asked += 1
        return SNAPSHOT if self.asked == 1 else self.after

    async def call(self, name: str, arguments: object) -> Verdict:
        return self.verdict

    def last_row(self) -> int:
        return 3

    def rows(self, after: int) -> list[JournalRow]:
        assert after == 3
        return cast(list[JournalRow], [Recorded(verdict) for verdict in self.recorded])


@dataclass
class Recorded:
    verdict: Verdict


async def judge(**changed: Any) -> Verdict:
    return await refused(cast(RunningCell, ScriptedCell(**changed)), "placement.confirm", codes=("pose_stale",))


def altered(**fields: Any) -> Verdict:
    return msgspec.structs.replace(REJECTED, **fields)


async def test_a_refusal_that_changes_nothing_and_is_journalled_passes() -> None:
    assert await judge() == REJECTED
    running = [Running(branch="toolplan", operation="plan", id="2")]
    await judge(after=msgspec.structs.replace(SNAPSHOT, running=running))


@pytest.mark.parametrize(
    ("changed", "word"),
    [
        ({"verdict": altered(decision="accepted", reason=None)}, "must be rejected"),
        ({"verdict": altered(decision="failed")}, "must be rejected"),
        ({"verdict": altered(reason=Reason(code="busy", text="Busy."))}, "pose_stale"),
        ({"after": msgspec.structs.replace(SNAPSHOT, sequence=8)}, "changed"),
        ({"after": msgspec.structs.replace(SNAPSHOT, latched=True)}, "changed"),
        ({"after": msgspec.structs.replace(SNAPSHOT, branches={"placement": "placed"})}, "changed"),
        ({"after": msgspec.structs.replace(SNAPSHOT, plan="another")}, "changed"),
        ({"recorded": []}, "journal"),
        ({"recorded": [altered(id="2")]}, "journal"),
    ],
)
async def test_anything_else_does_not(changed: dict[str, Any], word: str) -> None:
    with pytest.raises(Unmet, match=word):
        await judge(**changed)


def test_a_condition_that_does_not_hold_is_unmet() -> None:
    expect(True, "never told")
    with pytest.raises(Unmet, match="It moved"):
        expect(False, "It moved.")


def test_a_held_tool_stays_until_it_is_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = OperatedCell(placement="placed")
    cell.client.hold()
    run(monkeypatch, held(cell.as_cell))
    assert cell.client.asked == ["placement.back_off"], "it was tried, and refused"
    run(monkeypatch, confirmed(cell.as_cell))
    assert (cell.client.latched, cell.client.branches["placement"]) == (False, "standoff")
    with pytest.raises(Unmet, match="released although nobody confirmed"):
        run(monkeypatch, confirmed(cell.as_cell))


@pytest.mark.parametrize(
    ("latched", "placement", "text"),
    [(False, "held", "expected state did not come"), (True, "placed", "expected state did not come")],
)
def test_a_tool_that_is_not_held_is_unmet(
    monkeypatch: pytest.MonkeyPatch, latched: bool, placement: str, text: str
) -> None:
    cell = OperatedCell(placement=placement)
    cell.client.latched = latched
    with pytest.raises(Unmet, match=text):
        run(monkeypatch, held(cell.as_cell))


def test_a_tool_that_may_move_while_latched_is_unmet(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = OperatedCell(placement="placed")
    cell.client.hold()
    monkeypatch.setattr(cell.client, "call", lambda name, arguments: _accepted(name))
    with pytest.raises(Unmet, match="must be rejected: latched"):
        run(monkeypatch, held(cell.as_cell))


async def _accepted(name: str) -> Verdict:
    branch, _, operation = name.partition(".")
    return altered(branch=branch, operation=operation, decision="accepted", reason=None)


def test_refusals_of_an_edge_are_counted_by_their_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    cell = OperatedCell()
    raw = ScriptedRaw(cell)
    for reason in ("malformed", "malformed", "too_old"):
        raw.refuse(reason)
    assert run(monkeypatch, reported(cell.as_cell, 0, edge="gateway", code="malformed", count=2)) == 2
    with pytest.raises(Unmet, match="has 2 commands that gateway refused as malformed; expected 3"):
        run(monkeypatch, reported(cell.as_cell, 0, edge="gateway", code="malformed", count=3))
    with pytest.raises(Unmet, match="has 0 commands that bus refused"):
        run(monkeypatch, reported(cell.as_cell, 0, edge="bus", code="malformed", count=2))


async def test_a_refusal_at_the_edge_needs_no_row() -> None:
    cell = cast(RunningCell, ScriptedCell(recorded=[]))
    await refused_at_edge(cell, "placement.confirm", {}, code="pose_stale")
    with pytest.raises(Unmet, match="must be rejected: malformed"):
        await refused_at_edge(cell, "placement.confirm", {}, code="malformed")
