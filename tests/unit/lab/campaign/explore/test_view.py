"""What a session knows: what permits a motion or a pulse now, and what its journal has decided."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.journal import JournalReader, JournalRow
from pcmrs_lab.campaign.explore.view import Moved, TimedFlag, View, refuses_the_id
from tests.unit.lab.campaign.explore.ratms_views import (
    APPROACH,
    FOLLOWS,
    PLACED,
    PLAN,
    READY,
    decided,
    joints,
    shown,
    view,
)
from tests.unit.lab.scripted_client import row


class Reader:
    """A journal of these rows."""

    def __init__(self, *rows: JournalRow) -> None:
        self.rows = list(rows)

    def read(self, after: int) -> Iterator[Any]:
        for sequence, each in enumerate(self.rows[after:], after + 1):
            yield SimpleNamespace(sequence=sequence, row=each)


def take(known: View, *rows: JournalRow) -> None:
    known.take_rows(cast(JournalReader, Reader(*rows)))


def test_a_condition_has_the_time_of_its_last_change() -> None:
    flag = TimedFlag()
    assert flag.off_for(5.0) == float("inf")
    flag.set(True, 1.0)
    flag.set(True, 2.0)
    assert (flag.changed, flag.off_for(9.0)) == (1.0, 0.0)
    flag.set(False, 3.0)
    flag.set(False, 4.0)
    assert flag.off_for(5.0) == 2.0


@pytest.mark.parametrize(
    ("given", "allowed"),
    [
        ({}, False),
        ({"running": [PLAN]}, False),
        ({"running": [APPROACH]}, True),
        ({"activities": [FOLLOWS]}, True),
        ({"running": [APPROACH], "latched": True}, False),
    ],
)
def test_a_motion_or_a_moving_activity_permits_motion(given: dict[str, Any], allowed: bool) -> None:
    assert view(shown(states=READY, **given)).motion.holds is allowed


def test_nothing_is_permitted_without_a_daemon() -> None:
    known = view(shown(states=READY, running=[APPROACH]), now=7.0)
    known.now = 8.0
    known.end_run()
    assert (known.motion.holds, known.motion.changed, known.snapshot) == (False, 8.0, None)
    known.begin_run()
    assert known.run == 2
    assert known.before is None


def test_snapshots_are_kept_in_their_order() -> None:
    first, second = shown(1), shown(2, latched=True)
    known = view(first, second)
    assert (known.before, known.snapshot, known.latch.holds) == (first, second, True)


@pytest.mark.parametrize("operation", ["fire", "arm"])
@pytest.mark.parametrize("stimulation", ["armed", "disarmed"])
@pytest.mark.parametrize("latched", [False, True])
def test_a_pulse_is_permitted_where_placed_armed_and_asked(
    monkeypatch: pytest.MonkeyPatch, operation: str, stimulation: str, latched: bool
) -> None:
    known = view()
    monkeypatch.setattr(known, "_allows_motion", lambda _: False)  # RATMS has no stimulator
    running = [SimpleNamespace(branch="stimulation", operation=operation, id="1")]
    states = PLACED | {"stimulation": stimulation}
    snapshot: Any = SimpleNamespace(branches=states, running=running, latched=latched, activities=[], registration=None)
    known.take_snapshot(snapshot)
    assert known.pulse.holds is ((operation, stimulation, latched) == ("fire", "armed", False))


def test_outcomes_are_found_by_source_and_id() -> None:
    known = view()
    accepted, rejected = decided(id="1"), decided("robot.connect", "rejected", "busy", id="2")
    take(known, row("intent"), row(verdict=accepted), row(verdict=rejected))
    assert known.outcomes == {("bus:local", "1"): accepted, ("bus:local", "2"): rejected}
    assert known.by_id["2"] == rejected
    assert known.needless_rows == []


def test_each_row_is_read_once() -> None:
    known, reader = view(), Reader(row(verdict=decided("robot.acknowledge", id="1", state="1")))
    for _ in range(3):
        known.take_rows(cast(JournalReader, reader))
    assert known.released == 1


@pytest.mark.parametrize(
    ("name", "decision", "released"),
    [
        ("robot.acknowledge", "accepted", 1),
        ("robot.acknowledge", "rejected", 0),
        ("robot.connect", "accepted", 0),
        ("robot.no_such", "accepted", 0),
    ],
)
def test_an_accepted_acknowledgement_releases(name: str, decision: str, released: int) -> None:
    known = view()
    take(known, row(verdict=decided(name, decision, state="1")))
    assert known.released == released


def test_a_registration_is_in_force_by_its_verdict() -> None:
    known = view(shown(states=READY, registration="registration-7"))
    assert not known.registered
    take(known, row(verdict=decided("registration.register", "rejected", "busy", id="7")))
    assert not known.registered
    take(known, *[row()] * 1, row(verdict=decided("registration.register", id="7")))
    assert known.registered
    known.take_snapshot(shown(states=READY, registration="registration-8"))
    assert not known.registered
    known.begin_run()
    known.take_snapshot(shown(states=READY, registration="registration-7"))
    assert not known.registered, "a started daemon has none"


def test_a_previous_registration_needs_one_before() -> None:
    known = view(shown(states=READY, registration="registration-7"))
    taken_back = row(verdict=decided("registration.use_previous", id="7"))
    take(known, taken_back)
    assert not known.registered
    known = view(shown(states=READY, registration="registration-7"))
    take(known, row(verdict=decided("registration.register", id="6")), taken_back)
    assert known.registered


def test_a_rejected_event_of_a_device_needs_no_row() -> None:
    known = view()
    lost = decided("robot.link_lost", "rejected", "not_allowed")
    assert known.is_rejected_event(lost)
    assert not known.is_rejected_event(decided("robot.link_lost"))
    assert not known.is_rejected_event(decided("robot.connect", "rejected", "busy"))
    assert not known.is_rejected_event(decided("no.such", "rejected", "busy"))
    take(known, row(verdict=lost, source="bus:anna"))
    assert known.needless_rows == [], "a client may ask for anything"
    take(known, row(), row(verdict=lost, source="device:robot"))
    assert known.needless_rows == ["robot.link_lost, which device:robot has reported"]


def test_decisions_are_counted_by_name() -> None:
    known = view()
    for decision in ("accepted", "accepted", "failed"):
        known.take_verdict(decided(decision=decision))
    assert known.seen == {"accepted placement.approach": 2, "failed placement.approach": 1}


def test_an_id_that_is_refused_is_told_from_a_decision() -> None:
    assert refuses_the_id(decided(decision="rejected", code="id_reused"))
    assert not refuses_the_id(decided(decision="rejected", code="busy"))
    assert not refuses_the_id(decided())


def test_the_fastest_joint_is_the_speed_of_an_arm() -> None:
    assert Moved(joints(0.25)).speed == 0.25


IDLE = "timer:placement.idle"
BEGUN = {"fields": {"after": 10.0}}


@pytest.mark.parametrize(
    ("given", "early"),
    [
        ([("device", "timer_started", 0.0), ("outcome", "left_alone", 10.0)], False),
        ([("device", "timer_started", 0.0), ("outcome", "left_alone", 9.0)], True),
        ([("device", "timer_started", 0.0), ("device", "timer_started", 5.0), ("outcome", "left_alone", 12.0)], True),
        ([("device", "timer_started", 0.0), ("device", "timer_ended", 5.0), ("outcome", "left_alone", 12.0)], True),
        ([("outcome", "left_alone", 12.0)], True),
    ],
)
def test_an_event_that_comes_before_its_time_is_seen(given: list[tuple[Any, str, float]], early: bool) -> None:
    known = view(shown())
    posted = decided("placement.left_alone")
    rows = [
        row("outcome", posted, source=IDLE, monotonic=at)
        if kind == "outcome"
        else row(kind, source=IDLE, operation=code, result=BEGUN, monotonic=at)
        for kind, code, at in given
    ]
    take(known, *rows)
    assert bool(known.early_timers) is early
