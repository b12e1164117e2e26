"""Each invariant holds on what a right daemon does, and is violated by the defect that it is for."""

from __future__ import annotations

from typing import Any

import pytest
from msgspec.structs import replace

from pcmrs.errors import JournalError
from pcmrs.fsm.blueprint import Condition, PropertySpec
from pcmrs.messages import Running, Snapshot
from pcmrs_lab.campaign.explore import invariants
from pcmrs_lab.campaign.explore.invariants import BRAKED, BRAKED_ANYHOW, INVARIANTS, LATE_PULSE, braked
from pcmrs_lab.campaign.explore.view import Answered, Fired, Moved, View
from tests.unit.lab.blueprints import small
from tests.unit.lab.campaign.explore.ratms_views import (
    APPROACH,
    PLACED,
    PLAN,
    READY,
    command,
    decided,
    event,
    joints,
    shown,
    view,
)


def broken(known: View, what: Any) -> set[str]:
    """Names of the invariants that an event violates."""
    found = {each.__name__: each(known, what) for each in INVARIANTS[type(what)]}
    return {name for name, text in found.items() if text is not None}


def published(snapshot: Snapshot, *before: Snapshot) -> set[str]:
    return broken(view(*before, snapshot), snapshot)


def test_a_started_daemon_breaks_nothing() -> None:
    assert published(shown()) == set()
    assert published(shown(2, states={"robot": "1"}), shown()) == set()


def test_a_started_daemon_has_all_branches_in_their_first_state() -> None:
    assert published(shown(states={"robot": "1"})) == {"starts_with_nothing"}


@pytest.mark.parametrize(
    ("snapshot", "name"),
    [
        (shown(2, states={"robot": "2"}, flags={}), "one_state_per_branch"),
        (replace(shown(2, states={"robot": "1"}), flags=shown().flags), "one_state_per_branch"),
        (shown(2, states={"placement": "standoff"}), "children_fit_their_parents"),
        (shown(2, states=PLACED | {"toolplan": "0"}, registration="r"), "promises_are_kept"),
        (shown(2, running=[APPROACH]), "promises_are_kept"),
        (shown(2, states=READY, registration="registration-9"), "registered_by_a_verdict"),
        (shown(0), "sequence_never_goes_back"),
    ],
)
def test_a_wrong_state_is_seen(snapshot: Snapshot, name: str) -> None:
    assert name in published(snapshot, shown())


def test_a_promise_about_what_is_accepted_is_not_looked_at() -> None:
    ready = Condition(states={"top": ["10"]})

    def judged(**given: Condition) -> str | None:
        promise = PropertySpec(id="p", text="Never ready.", **given)
        known = View(replace(small(), properties=[promise]))
        return invariants.promises_are_kept(known, replace(shown(2), branches=small().initial() | {"top": "10"}))

    assert judged(never=ready) == "p is broken: Never ready."
    assert judged(always=ready) is None
    assert judged(when=ready, never=Condition(accepted=["top.clear"])) is None
    assert judged(when=Condition(accepted=["sub.finish"]), never=ready) is None


def test_no_motion_begins_while_stop_is_latched() -> None:
    stopped = shown(1, states=READY, latched=True)
    assert "nothing_begins_while_latched" in published(replace(stopped, running=[APPROACH]), stopped)
    was_running = replace(stopped, running=[APPROACH])
    assert "nothing_begins_while_latched" not in published(was_running, was_running)
    assert "nothing_begins_while_latched" not in published(replace(stopped, running=[PLAN]), stopped)
    other = replace(was_running, running=[replace(APPROACH, id="a2")])
    assert "nothing_begins_while_latched" in published(other, was_running)


def test_a_danger_latches_with_the_next_snapshot() -> None:
    known = view(shown())
    assert broken(known, event("force_limit", danger=True)) == set()
    assert broken(known, shown(2)) == {"danger_latches"}
    assert broken(known, shown(3)) == set(), "it is told once"
    broken(known, event("force_limit", danger=True))
    assert broken(known, shown(4, latched=True)) == set()
    broken(known, event("hold_not_confirmed", danger=True))
    assert broken(known, shown(5)) == set(), "it comes when the stop has ended"
    broken(known, event("force_limit"))
    assert broken(known, shown(6)) == set()


def test_a_latch_is_released_by_an_acknowledgement_only() -> None:
    stopped, free = shown(1, latched=True), shown(2)
    known = view(stopped, free)
    assert broken(known, free) == {"released_by_acknowledging"}
    known = view(stopped, free)
    known.released = 1
    assert broken(known, free) == set()
    assert known.released == 0, "each releases once"


def test_an_arm_that_may_not_move_stands_after_its_brakes() -> None:
    known = view(shown(1), shown(2), now=100.0)
    known.motion.changed = known.latch.changed = 90.0
    moves = {"nothing_moves_unasked"}
    assert broken(known, Moved(joints(0.1, 90.0 + BRAKED - 0.01))) == set()
    assert broken(known, Moved(joints(0.1, 90.0 + BRAKED + 0.01))) == moves
    assert broken(known, Moved(joints(1e-4, 99.0))) == set()
    known.by_hand = 99.5
    assert broken(known, Moved(joints(0.1, 99.0))) == set(), "someone pushes"
    known.calm.set(False, 98.0)
    assert broken(known, Moved(joints(0.1, 99.6))) == moves
    assert broken(known, Moved(joints(0.1, 90.0 + BRAKED_ANYHOW - 0.1))) == set()


def test_an_arm_stands_after_stop() -> None:
    known = view(shown(1, latched=True, states=READY, running=[APPROACH]), now=90.0)
    known.now = 100.0
    assert broken(known, Moved(joints(0.1, 91.0))) >= {"stop_holds"}
    assert "stop_holds" not in broken(known, Moved(joints(0.1, 90.5)))


def test_brakes_have_longer_while_anything_is_wrong() -> None:
    known = view(now=100.0)
    assert braked(known) == BRAKED
    known.calm.set(False, 90.0)
    assert braked(known) == BRAKED_ANYHOW
    known.calm.set(True, 99.0)
    assert braked(known) == BRAKED_ANYHOW, "it has only just ended"
    known.now = 99.0 + BRAKED_ANYHOW + 0.1
    assert braked(known) == BRAKED


@pytest.mark.parametrize("published_first", [False, True])
def test_a_decision_is_in_the_journal_before_anyone_knows_it(published_first: bool) -> None:
    known, verdict = view(shown()), decided(id="1")
    what: Any = verdict if published_first else Answered(command(), verdict)
    assert broken(known, what) == {"durable_before_known"}
    other = replace(verdict, decision="failed")
    known.outcomes["bus:anna", "1"] = known.by_id["1"] = other
    assert "durable_before_known" in broken(known, what)
    known = view(shown())
    known.outcomes["bus:anna", "1"] = known.by_id["1"] = verdict
    assert broken(known, what) == set()


@pytest.mark.parametrize(
    ("verdict", "excused", "broken_by"),
    [
        (decided("robot.link_lost", "rejected", "not_allowed"), False, False),
        (decided("robot.link_lost", "accepted"), False, True),
        (decided("placement.home", "rejected", "journal_broken"), False, True),
        (decided("placement.home", "rejected", "journal_broken"), True, False),
        (decided("placement.home", "unknown"), True, False),
        (decided("placement.home", "accepted"), True, True),
        (decided("placement.home", "rejected", "id_reused"), False, False),
    ],
)
def test_only_some_decisions_need_no_row(verdict: Any, excused: bool, broken_by: bool) -> None:
    known = view(shown())
    known.excused = excused
    found = invariants.durable_before_known(known, Answered(command(), verdict))
    assert (found is not None) is broken_by


def test_a_needless_row_is_told() -> None:
    known = view(shown())
    verdict = known.by_id["1"] = decided(id="1")
    assert broken(known, verdict) == set()
    known.needless_rows.append("robot.link_lost, which device:robot has reported")
    known.performed.clear()
    assert broken(known, verdict) == {"only_changes_leave_rows"}


def test_an_early_event_of_a_timer_is_told() -> None:
    known = view(shown())
    verdict = known.by_id["1"] = decided(id="1")
    known.early_timers.append("placement.left_alone, which timer:placement.idle has posted")
    assert broken(known, verdict) == {"timers_keep_their_time"}


def test_a_command_is_performed_once() -> None:
    known = view(shown())
    verdict = known.by_id["1"] = decided(id="1")
    assert broken(known, verdict) == set()
    assert broken(known, verdict) == {"performed_once"}
    rejected = known.by_id["2"] = decided(decision="rejected", code="busy", id="2", sequence=9)
    assert broken(known, rejected) == broken(known, rejected) == set()


def test_what_failed_with_the_journal_may_be_published_again() -> None:
    known = view(shown())
    unknown = decided(decision="unknown", code=JournalError.code, id="1")
    assert invariants.performed_once(known, unknown) is None
    assert invariants.performed_once(known, decided(id="1")) is None


def test_a_repeat_gets_the_first_decision() -> None:
    known = view(shown())
    first, other = decided(id="1"), decided(decision="failed", id="1")
    known.outcomes["bus:anna", "1"] = first
    assert broken(known, Answered(command(), first)) == set()
    assert broken(known, Answered(command(), first)) == set()
    assert "repeats_get_the_recorded_verdict" in broken(known, Answered(command(), other))
    assert invariants.repeats_get_the_recorded_verdict(known, Answered(command(who="ben"), other)) is None
    reused = decided(decision="rejected", code="id_reused", id="1")
    assert invariants.repeats_get_the_recorded_verdict(known, Answered(command(), reused)) is None
    known.excused = True
    assert invariants.repeats_get_the_recorded_verdict(known, Answered(command(), other)) is None


def test_a_rejection_changes_nothing() -> None:
    known = view(shown(3, states=READY))
    verdict = decided("placement.home", "rejected", "busy", state="standoff", sequence=3)
    assert invariants.rejection_changes_nothing(known, verdict) is not None
    assert invariants.rejection_changes_nothing(known, replace(verdict, state="retracted")) is None
    assert invariants.rejection_changes_nothing(known, replace(verdict, sequence=4)) is None, "something else did"
    assert invariants.rejection_changes_nothing(known, replace(verdict, decision="failed")) is None


def test_a_pulse_needs_something_that_allows_it() -> None:
    known = view(shown(), now=100.0)
    assert broken(known, Fired(1)) == {"fires_only_armed_and_placed"}
    known.pulse.set(True, 99.0)
    assert broken(known, Fired(2)) == set()
    known.pulse.set(False, 100.0)
    known.now = 100.0 + LATE_PULSE - 0.1
    assert broken(known, Fired(3)) == set(), "it was asked for in time"
    known.now = 100.0 + LATE_PULSE + 0.1
    assert broken(known, Fired(4)) == {"fires_only_armed_and_placed"}


def test_an_operation_is_found_by_its_branch() -> None:
    retreat = Running(branch="placement", operation="home", id="h1")
    stopped = shown(1, states=PLACED, latched=True)
    spec = view().blueprint.branches["placement"].operations["home"]
    found = published(replace(stopped, running=[retreat]), stopped)
    assert ("nothing_begins_while_latched" in found) is spec.blocked_when_latched
