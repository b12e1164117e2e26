"""The session reader: outcomes, intents without an outcome, stored data, and sessions by the start of their id."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.errors import FileFormatError, JournalError
from pcmrs.journal import JournalRow, StoredRow
from pcmrs.messages import BlueprintTag, Reason, Verdict
from pcmrs.report.session_journal import (
    SessionJournal,
    configured_calibrations,
    find_session,
    read_placements,
    source_without_port,
)
from tests.unit.report.report_journals import write_journal

TAG = BlueprintTag(id="ratms", version="1.0.0", hash="ab" * 32)
POSE = {"position": [0.0, 0.0, 0.1], "quat_xyzw": [0.0, 0.0, 0.0, 1.0]}
PATH = Path("journal.sqlite")


def row(kind: Any, command: str, **fields: Any) -> JournalRow:
    return JournalRow(
        kind=kind,
        wall=1.8e9,
        monotonic=1.0,
        boot_id="b",
        session_id="s",
        blueprint=TAG,
        source="udp:planner:127.0.0.1",
        command_id=command,
        branch="placement",
        operation="confirm",
        **fields,
    )


def outcome(
    command: str, decision: Any, reason: Reason | None = None, *, result: Any = None, data: Any = None
) -> JournalRow:
    verdict = Verdict(
        id=command,
        branch="placement",
        operation="confirm",
        decision=decision,
        state="placed",
        sequence=1,
        reason=reason,
        result=result,
    )
    return row("outcome", command, verdict=verdict, result=data)


def journal(*rows: JournalRow) -> SessionJournal:
    stored = [StoredRow(sequence=number, row=each, previous_hash=b"", hash=b"") for number, each in enumerate(rows, 1)]
    return SessionJournal(stored)


def test_outcomes_are_divided_by_their_decision() -> None:
    refused = Reason(code="no_plan", text="There is no plan.", fields={})
    session = journal(
        row("intent", "1"), outcome("1", "accepted", result={"planned": POSE}), outcome("2", "rejected", refused)
    )
    (accepted,), (rejected,) = session.accepted(), session.not_accepted()
    assert (accepted.sequence, accepted.name, accepted.code, accepted.text) == (2, "placement.confirm", "", "")
    assert (rejected.sequence, rejected.code, rejected.text) == (3, "no_plan", "There is no plan.")
    assert list(session.accepted("placement.confirm")) == [accepted]
    assert not list(session.accepted("placement.home"))


def test_a_pose_is_none_where_the_result_holds_no_pose() -> None:
    (found,) = journal(outcome("1", "accepted", result={"planned": POSE, "measured": {"position": [0.0]}})).outcomes
    planned = found.pose("planned")
    assert planned is not None
    assert planned.translation.tolist() == [0.0, 0.0, 0.1]
    assert found.pose("measured") is None
    assert found.pose("other") is None


def test_an_intent_without_an_outcome_is_unfinished() -> None:
    (found,) = journal(row("intent", "1"), outcome("1", "accepted"), row("intent", "2")).unfinished()
    assert found.sequence == 3


def test_stored_data_is_the_last_value_or_none_after_clearing() -> None:
    session = journal(
        outcome("1", "accepted", data={"ceiling": 1, "plan": 2}), outcome("2", "accepted", data={"plan": None})
    )
    assert [session.stored_data(field) for field in ("ceiling", "plan", "hunt")] == [1, None, None]


@pytest.mark.parametrize(("start", "index"), [("a1", 0), ("a2", 1), (None, 2)])
def test_a_session_is_found_by_the_start_of_its_id(start: str | None, index: int) -> None:
    assert find_session(["a1x", "a2x", "b"], start, PATH) == index


@pytest.mark.parametrize(
    ("sessions", "start", "text"),
    [
        (["a1", "a2"], "a", "has 2 sessions that begin with a; the last: a1, a2"),
        (["a1"], "c", "has no sessions that begin with c; the last: a1"),
        ([], None, "has no sessions that begin with anything; the last: none"),
    ],
)
def test_no_or_several_sessions_are_an_error(sessions: list[str], start: str | None, text: str) -> None:
    with pytest.raises(JournalError, match=text):
        find_session(sessions, start, PATH)


def test_only_configured_calibrations_are_listed() -> None:
    calibration = {"tool_file": "/cal/tool.toml", "tip_file": "/cal/tip.toml", "pointer_file": ""}
    assert configured_calibrations({"procedure": {"calibration": calibration}}) == {
        "tool": "/cal/tool.toml",
        "tip": "/cal/tip.toml",
    }
    assert configured_calibrations({}) == {}


def test_the_port_is_no_part_of_a_source() -> None:
    assert source_without_port("bus:local:1234") == "bus:local"
    assert source_without_port(None) == ""


def test_placements_have_the_journalled_or_the_given_standoff(tmp_path: Path) -> None:
    result = {"planned": POSE, "measured": POSE, "confirm_offset": 0.01}
    rows = [outcome("1", "accepted", result=result), outcome("2", "failed", result=result)]
    path = write_journal([msgspec.to_builtins(each) for each in rows], tmp_path / "journal.sqlite")
    assert [(each.placement.name, each.standoff) for each in read_placements(path, None)] == [("1", 0.01)]
    assert [each.standoff for each in read_placements(path, 5.0)] == [0.005]


def test_a_journal_without_placements_is_refused(tmp_path: Path) -> None:
    path = write_journal([msgspec.to_builtins(row("intent", "1"))], tmp_path / "journal.sqlite")
    with pytest.raises(FileFormatError, match="nothing was placed"):
        read_placements(path, None)
