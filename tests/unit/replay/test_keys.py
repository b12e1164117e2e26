"""A journalled row and its replayed counterpart have one key, whatever was drawn at random."""

from __future__ import annotations

import pytest

from pcmrs.messages import Command, Reason
from pcmrs.replay._history import read_runs
from pcmrs.replay._keys import (
    command_key,
    command_of,
    event_key,
    is_danger,
    is_followed_by_report,
    is_rejected_report,
    is_rejection,
    key_of,
    same_reason,
)
from tests.unit.replay.golden import GOLDEN, WORKFLOWS
from tests.unit.replay.rows import event, intent, outcome

ONE, OTHER = "0123456789abcdef" * 2, "f" * 32


def command(source: str, drawn: str) -> Command:
    return Command(id=f"link_lost-{drawn}", branch="robot", operation="link_lost", source=source, arguments={})


@pytest.mark.parametrize(("source", "same"), [("device:robot", True), ("activity:follow_head", True), ("bus:a", False)])
def test_only_ids_that_the_daemon_draws_are_left_out(source: str, same: bool) -> None:
    one, other = (command_key("outcome", command(source, drawn)) for drawn in (ONE, OTHER))
    assert (one == other) == same
    assert one != command_key("intent", command(source, ONE))


def test_an_event_that_stops_the_cell_is_another_one() -> None:
    assert event_key("robot", "force_limit", danger=True) != event_key("robot", "force_limit", danger=False)
    assert key_of(event("force_limit", danger=True)) == event_key("robot", "force_limit", danger=True)
    assert (is_danger(event("x", danger=True)), is_danger(event("x")), is_danger(intent("a.b"))) == (True, False, False)


@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_the_key_of_a_row_is_that_of_its_command(workflow: str) -> None:
    for run in read_runs(GOLDEN / f"{workflow}.jsonl"):
        for each in run.decided():
            row, key = each.row, key_of(each.row)
            assert key is not None
            if row.kind != "device":
                assert command_key(row.kind, command_of(row)) == key  # type: ignore[arg-type]
        own = [each.row for each in run.rows if each.row.kind not in ("intent", "outcome", "device")]
        assert own, "the daemon's own rows are not replayed"
        assert {key_of(row) for row in own} == {None}


def test_rejections_are_told_from_failures_and_by_their_source() -> None:
    reason = Reason(code="latched", text="Stop is latched.")
    refused = outcome("robot.connect", decision="rejected", reason=reason)
    assert is_rejection(refused)
    assert not is_rejection(outcome("robot.connect", decision="failed", reason=reason))
    assert not is_rejection(intent("robot.connect"))
    assert not is_rejected_report(refused)
    assert is_rejected_report(outcome("robot.connect", decision="rejected", reason=reason, source="device:robot"))
    assert same_reason(refused, "latched", "Stop is latched.")
    assert not same_reason(refused, "latched", "Another.")
    assert not same_reason(outcome("robot.connect"), None, "")


def test_commands_after_a_report_are_known_by_id_and_source() -> None:
    assert is_followed_by_report(outcome("robot.link_lost", f"link_lost-{ONE}", source="device:robot"))
    assert not is_followed_by_report(outcome("robot.link_lost", f"link_lost-{ONE}", source="bus:test"))
    assert not is_followed_by_report(outcome("robot.link_lost", "c1", source="device:robot"))
