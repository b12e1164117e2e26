"""Later rows show until when a decision was not durable: they were made by older states, locks and commits."""

from __future__ import annotations

from pcmrs.journal import JournalRow
from pcmrs.messages import Reason
from pcmrs.replay._durability import WINDOW, held_until, name_of, rejected_by_stop, running_operations
from tests.unit.replay.rows import event, intent, outcome

STOPPED = Reason(code="stopped", text="Somebody pressed Stop.")


def busy(running: list[str], command: str, sequence: int = 9) -> JournalRow:
    reason = Reason(code="busy", text="Busy.", fields={"running": running})
    return outcome("toolplan.plan", command, "rejected", reason=reason, sequence=sequence)


def test_a_rejection_that_names_an_older_commit_was_made_before() -> None:
    rows = [
        outcome("robot.connect", "c1", sequence=5),
        outcome("toolplan.plan", "c2", "rejected", sequence=4),
        outcome("toolplan.plan", "c3", "rejected", sequence=5),
    ]
    assert held_until(rows) == [1, 1, 2]


def test_command_that_found_locks_held_came_before_release() -> None:
    found = busy(["robot.connect"], "c2")
    rows = [outcome("robot.connect", "c1", sequence=5), found, busy(["placement.home"], "c3")]
    assert held_until(rows)[0] == 1
    again = [rows[0], outcome("robot.connect", "c4", sequence=9), found]
    assert held_until(again)[0] == 0, "the later one of that name held them"


def test_an_intent_by_older_states_was_decided_before_the_commit() -> None:
    before, after = {"robot": "0", "toolplan": "0"}, {"robot": "1", "toolplan": "0"}
    rows = [
        outcome("toolplan.clear", "c0", states=before),
        outcome("robot.connect", "c1", sequence=2, states=after),
        intent("digitization.digitize_all", "c2", states=before),
        intent("placement.home", "c3", states=after),
    ]
    assert held_until(rows)[1] == 2


def test_nothing_beyond_the_window_is_looked_at() -> None:
    older = outcome("toolplan.plan", "last", "rejected", sequence=4)
    for distance, held in ((WINDOW - 1, WINDOW - 1), (WINDOW, 0)):
        between = [event("warm") for _ in range(distance - 1)]
        assert held_until([outcome("robot.connect", "c1", sequence=5), *between, older])[0] == held


def test_commands_that_a_stop_turned_away_lead_to_it() -> None:
    """They are journalled just before it, with its code and text."""
    stop = event("stopped", "bus:test", danger=True, text=STOPPED.text)
    turned_away = [outcome("toolplan.plan", f"c{number}", "rejected", reason=STOPPED) for number in (2, 3)]
    rows = [outcome("robot.connect", "c1"), *turned_away, stop]
    assert list(rejected_by_stop(rows)) == [(1, 3)]
    assert held_until(rows)[0] == 3, "they waited for the only decision that was pending"
    other = event("stopped", "bus:test", danger=True, text="Another text.")
    assert list(rejected_by_stop([*rows[:-1], other])) == []
    assert list(rejected_by_stop([rows[0], stop])) == []


def test_names_of_running_operations_are_those_of_the_rejection() -> None:
    assert running_operations(busy(["robot.connect"], "c1")) == ["robot.connect"]
    assert running_operations(outcome("toolplan.plan", decision="rejected", reason=STOPPED)) == []
    assert name_of(outcome("toolplan.plan")) == "toolplan.plan"
