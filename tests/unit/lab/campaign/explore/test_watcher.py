"""The watcher of the arm misses no motion that nothing allows, and believes no verdict that the journal lacks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from pcmrs.messages import Running, Snapshot
from pcmrs.spatial import Transform
from pcmrs_lab.campaign.explore.invariants import BRAKED, BRAKED_ANYHOW
from pcmrs_lab.campaign.explore.watcher import (
    BEGINS_WITHIN,
    CHECKED_WITHIN,
    DECIDED,
    HELD,
    INWARDS,
    MOVED,
    RESTED,
    SECOND,
    UNASKED,
    Watcher,
)
from tests.unit.lab.campaign.explore.ratms_views import (
    APPROACH,
    FOLLOWS,
    PLACED,
    PLAN,
    READY,
    command,
    decided,
    event,
    shown,
    view,
)

DEADMAN = 1.0
GUIDES = replace(FOLLOWS, state="guided", name="teleoperate")


class Session:
    """A watcher of a session, and what it found broken."""

    def __init__(self) -> None:
        self.view = view()
        self.broken: list[str] = []
        self.texts: list[str] = []
        self.watcher = Watcher(self.view, self._break, DEADMAN)

    def _break(self, name: str, text: str) -> None:
        self.broken.append(name)
        self.texts.append(text)

    def show(self, now: float, snapshot: Snapshot | None = None, **given: Any) -> None:
        self.view.now = now
        published = snapshot or shown(**given)
        self.view.take_snapshot(published)
        self.watcher.take_snapshot(published, now)

    def step(self, now: float, joint: float = 0.0, *, rests: bool = True, **given: bool) -> None:
        self.view.now = now
        flags = {"at_rest": rests, "braking": False, "relieving": False} | given
        self.watcher.step(now, (0.0, joint), **flags)


@pytest.fixture
def session() -> Session:
    made = Session()
    made.show(0.0, states=READY)
    return made


# -- the arm ----------------------------------------------------------------------------------------------


def test_an_arm_that_rests_stays(session: Session) -> None:
    session.step(1.0)
    session.step(2.0, MOVED * 0.9)
    assert session.broken == []
    session.step(3.0, MOVED * 1.1)
    assert session.broken == ["the_arm_stays"]
    assert "0.0022 rad from where the arm stood" in session.texts[0]


def test_an_arm_that_is_pushed_or_relieves_may_be_elsewhere(session: Session) -> None:
    session.step(1.0)
    session.step(2.0, 0.5, relieving=True)
    session.view.by_hand = 4.0
    session.step(3.0, 0.7)
    session.step(5.0, 0.9)
    session.step(6.0, 0.9)
    assert session.broken == []


def test_a_motion_takes_the_arm_elsewhere(session: Session) -> None:
    session.step(1.0)
    session.show(2.0, states=READY, running=[APPROACH])
    session.step(3.0, 0.5, rests=False)
    session.show(4.0, states=READY)
    session.step(4.1, 0.5)
    session.step(4.2, 0.6)
    assert session.broken == [], "it settles: its verdict has not come"
    session.watcher.take_verdict(decided())
    session.step(4.3, 0.6)
    session.step(4.4, 0.7)
    assert session.broken == ["the_arm_stays"]


@pytest.fixture
def guided(session: Session) -> Session:
    """An arm that a hand has displaced, after it had rested."""
    session.view.by_hand = float("inf")
    session.step(0.0)
    session.step(0.1 + RESTED)
    session.step(3.0, UNASKED * 1.1, rests=False)
    return session


def test_motion_by_hand_while_nothing_runs_must_be_a_stop(guided: Session) -> None:
    guided.step(3.0 + BRAKED_ANYHOW - 0.1, UNASKED * 1.1)
    assert guided.broken == []
    guided.step(3.0 + BRAKED_ANYHOW + 0.1, UNASKED * 1.1)
    assert guided.broken == ["unasked_motion_is_a_stop"]


def test_motion_by_hand_that_has_become_a_stop_may_be_released(guided: Session) -> None:
    guided.show(3.5, states=READY, latched=True)
    guided.show(5.0, states=READY)
    guided.step(4.0 + BRAKED_ANYHOW, UNASKED * 1.1)
    guided.step(5.0 + 2 * BRAKED_ANYHOW, UNASKED * 1.1)
    assert guided.broken == []


@pytest.mark.parametrize(
    "shown_then",
    [{"running": [APPROACH], "states": READY}, {"states": {"robot": "0"}}, {"states": PLACED, "activities": [FOLLOWS]}],
)
def test_an_explained_displacement_is_no_stop(guided: Session, shown_then: dict[str, Any]) -> None:
    guided.show(3.5, **shown_then)
    guided.step(4.0 + BRAKED_ANYHOW, UNASKED * 1.1)
    assert guided.broken == []


def test_an_arm_that_comes_back_was_not_displaced(guided: Session) -> None:
    guided.step(4.0)
    guided.step(5.0, UNASKED * 1.1)
    guided.step(4.0 + BRAKED_ANYHOW, UNASKED * 1.1)
    assert guided.broken == []


def test_silence_of_the_daemon_is_held(session: Session) -> None:
    session.watcher.lose_daemon(10.0, crash=True)
    session.step(10.0 + DEADMAN, rests=False)
    session.step(10.0 + DEADMAN + HELD + 0.05, rests=False, braking=True)
    session.step(10.0 + DEADMAN + HELD + 0.1, rests=False)
    assert session.broken == [], "an arm at rest was held"
    session.step(10.0 + DEADMAN + HELD + 0.15, 0.001, rests=False)
    assert session.broken == ["silence_is_held"]


def test_a_daemon_that_ends_by_itself_is_not_silent(session: Session) -> None:
    session.watcher.lose_daemon(10.0, crash=False)
    session.step(20.0, rests=False)
    assert session.broken == []


def test_a_node_that_is_not_there_holds_later(session: Session) -> None:
    session.watcher.lose_daemon(10.0, crash=True)
    session.watcher.excuse_node(float("inf"))
    session.step(20.0, rests=False)
    assert session.broken == []
    session.watcher.node_is_back(20.0)
    session.step(20.0 + DEADMAN, rests=False)
    assert session.broken == []
    session.step(20.0 + DEADMAN + HELD + 0.1, 0.001, rests=False)
    assert session.broken == ["silence_is_held"]


def test_nothing_begins_after_the_hold_of_a_stop(session: Session) -> None:
    session.show(1.0, states=READY, running=[APPROACH])
    session.watcher.begins("follow", 1.1)
    assert session.broken == []
    session.watcher.held(1.5)
    session.watcher.begins("follow", 1.6)
    assert session.broken == ["nothing_begins_after_its_hold"]
    assert "placement.approach began before that" in session.texts[0]


def test_a_motion_that_began_after_the_hold_may_move(session: Session) -> None:
    session.watcher.held(1.0)
    session.show(2.0, states=READY, running=[APPROACH])
    session.watcher.begins("follow", 2.1)
    assert session.broken == []


def test_a_hold_by_which_an_activity_ends_is_none_of_a_stop(session: Session) -> None:
    following = PLACED | {"placement": "following"}
    session.show(1.0, states=following, activities=[FOLLOWS])
    session.watcher.held(1.5)
    session.watcher.begins("follow", 1.6)
    assert session.broken == []
    session.watcher.take_event(event("activity_ended", device="activity:follow_head"), 1.7)
    session.watcher.held(1.8)
    session.watcher.begins("follow", 1.9)
    assert session.broken == ["nothing_begins_after_its_hold"]


def test_what_moves_by_hand_begins_nothing(session: Session) -> None:
    session.watcher.held(1.0)
    session.view.by_hand = 5.0
    session.watcher.begins("follow", 2.0)
    assert session.broken == []


def test_an_approach_needs_a_reference_that_stayed(session: Session) -> None:
    session.show(1.0, states=READY, running=[APPROACH])
    session.watcher.take_event(event("reference_moved"), 1.5)
    session.watcher.begins("follow", 1.5 + BRAKED - 0.05)
    assert session.broken == [], "the hold for it is on its way"
    session.watcher.begins("follow", 1.5 + BRAKED_ANYHOW + 0.1)
    assert session.broken == ["approaches_only_when_ready"]


def test_a_new_registration_forgives_a_moved_reference(session: Session) -> None:
    session.watcher.take_event(event("reference_moved"), 1.0)
    session.watcher.take_verdict(decided("registration.register"))
    session.show(9.0, states=READY, running=[APPROACH])
    session.watcher.begins("follow", 9.1)
    assert session.broken == []


def test_a_retreat_needs_no_reference(session: Session) -> None:
    session.watcher.take_event(event("reference_moved"), 1.0)
    session.watcher.take_verdict(decided("registration.reference_moved"))
    session.show(9.0, states=PLACED, running=[Running(branch="placement", operation="home", id="h1")])
    session.watcher.begins("follow", 9.1)
    assert session.broken == []


def test_moved_reference_means_nothing_before_any_landmark() -> None:
    session = Session()
    session.show(0.0, states={"registration": "100"})
    session.watcher.take_event(event("reference_moved"), 1.0)
    session.watcher.take_verdict(decided("registration.reference_moved", "rejected", "not_allowed"))
    session.show(9.0, states=READY, running=[APPROACH])
    session.watcher.begins("follow", 9.1)
    assert session.broken == []


# -- messages -----------------------------------------------------------------------------------------------


def test_a_crash_while_guided_latches_the_next_daemon(session: Session) -> None:
    session.show(1.0, states=PLACED | {"placement": "guided"}, activities=[GUIDES])
    session.watcher.begins("begin_servo", 1.1)
    session.watcher.lose_daemon(2.0, crash=True)
    session.watcher.begin_run(shown(latched=True))
    assert session.broken == []
    session.watcher.lose_daemon(3.0, crash=True)
    session.watcher.begin_run(shown())
    assert session.broken == ["a_crash_in_motion_latches"]


@pytest.mark.parametrize("crash", [True, False])
def test_a_daemon_that_did_not_guide_starts_unlatched(session: Session, crash: bool) -> None:
    session.show(1.0, states=READY, running=[APPROACH])
    session.watcher.begins("follow", 1.1)
    session.watcher.lose_daemon(2.0, crash=crash)
    session.watcher.begin_run(shown())
    assert session.broken == []


def test_a_tool_stays_under_the_plan_that_brought_it() -> None:
    session = Session()
    session.show(1.0, states=PLACED, plan="p1", registration="r1")
    session.show(2.0, states=PLACED | {"placement": "standoff"}, plan="p1", registration="r1")
    assert session.broken == []
    session.show(3.0, states=PLACED, plan="p2", registration="r1")
    assert session.broken == ["the_tool_is_at_its_plan"]


def test_a_tool_that_was_withdrawn_may_go_to_another_plan() -> None:
    session = Session()
    session.show(1.0, states=PLACED, plan="p1", registration="r1")
    session.show(2.0, states=PLACED | {"placement": "held"}, plan="p1", registration="r1")
    session.show(3.0, states=PLACED, plan="p2", registration="r2")
    assert session.broken == []


def test_an_event_is_decided_in_time(session: Session) -> None:
    session.watcher.take_event(event("link_lost"), 1.0)
    session.step(1.0 + DECIDED - 0.1)
    session.watcher.take_event(event("not_an_operation"), 1.0)
    assert session.broken == []
    session.step(1.0 + DECIDED + 0.1)
    assert session.broken == ["no_event_is_lost"]


def test_an_event_that_was_decided_or_excused_is_not_lost(session: Session) -> None:
    session.watcher.take_event(event("link_lost"), 1.0)
    session.watcher.take_verdict(decided("robot.link_lost"))
    session.step(50.0)
    session.watcher.take_event(event("link_lost"), 50.0)
    session.view.excused = True
    session.step(100.0)
    session.view.excused = False
    session.watcher.lose_daemon(100.0, crash=True)
    session.watcher.begin_run(shown())
    session.step(200.0)
    assert session.broken == []


def test_no_event_is_rejected_for_the_moment_it_comes_at(session: Session) -> None:
    session.watcher.take_verdict(decided("robot.link_lost", "rejected", "not_allowed"))
    session.watcher.take_verdict(decided("placement.home", "rejected", "busy"))
    assert session.broken == []
    session.watcher.take_verdict(decided("robot.link_lost", "rejected", "busy"))
    assert session.broken == ["no_event_is_turned_away"]


def test_dangers_are_decided_before_a_motion(session: Session) -> None:
    session.watcher.take_event(event("force_limit", danger=True), 1.0)
    session.show(2.0, states=READY, running=[APPROACH])
    assert session.broken == ["dangers_are_decided_first"]
    assert "placement.approach begins, and force_limit is not decided" in session.texts[0]


def test_a_danger_that_was_decided_holds_nothing_back(session: Session) -> None:
    session.show(0.5, states=READY, running=[APPROACH])
    session.watcher.take_event(event("force_limit", danger=True), 1.0)
    session.show(1.5, states=READY, running=[APPROACH])
    session.watcher.take_verdict(decided("placement.force_limit", "rejected", "not_allowed"))
    session.show(2.0, states=READY)
    session.show(3.0, states=READY, running=[replace(APPROACH, id="a2")])
    assert session.broken == []


def test_a_command_without_an_id_begins_soon_or_not_at_all(session: Session) -> None:
    made = replace(APPROACH, id="ab" * 16)
    session.watcher.arrived("placement.approach", 1.0)
    session.show(1.0 + BEGINS_WITHIN - 0.1, states=READY, running=[made])
    session.show(3.0, states=READY)
    session.show(4.0, states=READY, running=[APPROACH])
    session.show(5.0, states=READY)
    assert session.broken == []
    session.watcher.arrived("placement.approach", 5.0)
    session.show(5.1 + BEGINS_WITHIN, states=READY, running=[replace(made, id="cd" * 16)])
    assert session.broken == ["motions_begin_in_time"]


def test_a_command_with_an_id_begins_in_time_planning_apart(session: Session) -> None:
    session.watcher.command_arrived("a1", 1.0)
    session.watcher.planning("placement.approach", 1.05, 0.5)
    session.watcher.planning("placement.home", 1.05, 5.0)
    session.show(1.0 + CHECKED_WITHIN + 0.49, states=READY, running=[APPROACH])
    session.watcher.command_arrived("a1", 2.0)  # a repeat of what runs
    session.show(9.0, states=READY, running=[APPROACH])
    session.show(9.1, states=READY)
    assert session.broken == []
    session.watcher.command_arrived("a2", 10.0)
    session.show(10.0 + CHECKED_WITHIN + 0.1, states=READY, running=[replace(APPROACH, id="a2")])
    assert session.broken == ["motions_begin_in_time"]


def test_a_loop_that_blocks_after_the_arrival_is_no_delay(session: Session) -> None:
    session.watcher.daemon_blocked(0.5, 0.5)
    session.watcher.command_arrived("a1", 1.0)
    session.watcher.daemon_blocked(1.05, 0.5)
    session.show(1.5, states=READY, running=[APPROACH])
    assert session.broken == []
    session.show(2.0, states=READY)
    session.watcher.daemon_blocked(3.0, 0.5)
    session.watcher.command_arrived("a2", 3.1)
    session.show(3.5, states=READY, running=[replace(APPROACH, id="a2")])
    assert session.broken == ["motions_begin_in_time"]


def test_string_command_with_an_id_begins_in_time_too(session: Session) -> None:
    session.watcher.command_arrived("17", 1.0)
    session.show(1.5, states=READY, running=[replace(APPROACH, id=f"{'ab' * 16}-17-0")])
    assert session.broken == ["motions_begin_in_time"]


def test_what_was_decided_or_does_not_move_has_no_time_to_begin(session: Session) -> None:
    session.watcher.command_arrived("a1", 1.0)
    session.watcher.take_verdict(decided(decision="rejected", code="busy", id="a1"))
    session.watcher.command_arrived("p1", 1.0)
    session.show(9.0, states=READY, running=[APPROACH, PLAN])
    assert session.broken == []


def test_a_danger_that_a_device_reports_must_be_a_stop(session: Session) -> None:
    session.watcher.emitted(event("drives_off", danger=True), 1.0)
    session.watcher.emitted(event("no_danger"), 1.0)
    session.step(1.0 + BRAKED_ANYHOW - 0.1)
    assert session.broken == []
    session.step(1.0 + BRAKED_ANYHOW + 0.1)
    assert session.broken == ["every_reported_danger_is_a_stop"]
    assert "robot drives_off" in session.texts[0]


@pytest.mark.parametrize("answer", [{"states": READY, "latched": True}, {"states": {"robot": "0"}}])
def test_a_reported_danger_that_was_answered_is_no_danger(session: Session, answer: dict[str, Any]) -> None:
    session.watcher.emitted(event("drives_off", danger=True), 1.0)
    session.show(2.0, **answer)
    session.step(2.1)
    session.show(3.0, states=READY)
    session.step(3.0 + BRAKED_ANYHOW)
    assert session.broken == []


def tool_at(height: float) -> Transform:
    """Above a body that is below it."""
    return Transform(np.eye(3), np.array((0.0, 0.0, height)))


def test_a_tool_comes_near_the_body_only_when_that_is_possible(session: Session) -> None:
    assert not session.watcher.must_stay_away(100.0)
    session.show(1.0, states=READY | {"toolplan": "0"})
    assert not session.watcher.must_stay_away(1.0 + BRAKED - 0.1), "it may brake"
    assert session.watcher.must_stay_away(1.0 + BRAKED_ANYHOW + 0.1)
    for height in (0.10, 0.05, 0.06):
        session.watcher.take_tool(tool_at(height), near=height < 0.05)
    assert session.broken == [], "it is far, or goes away"
    session.watcher.forget_tool()
    session.watcher.take_tool(tool_at(0.04), near=True)
    session.watcher.take_tool(tool_at(0.04 - 0.9 * INWARDS), near=True)
    assert session.broken == []
    session.watcher.take_tool(tool_at(0.04 - 1.1 * INWARDS), near=True)
    assert session.broken == ["the_tool_comes_near_only_when_ready"]


def test_no_daemon_and_a_latch_keep_the_tool_away(session: Session) -> None:
    session.show(1.0, states=READY, latched=True)
    assert session.watcher.must_stay_away(1.0 + BRAKED_ANYHOW + 0.1)
    session.show(10.0, states=READY)
    assert not session.watcher.must_stay_away(20.0)
    session.watcher.lose_daemon(20.0, crash=True)
    assert session.watcher.must_stay_away(20.0 + BRAKED_ANYHOW + 0.1)
    session.view.by_hand = 100.0
    assert not session.watcher.must_stay_away(50.0)


# -- people -------------------------------------------------------------------------------------------------


def test_an_answer_is_about_the_command(session: Session) -> None:
    session.watcher.answered(command(), decided())
    session.watcher.answered(command("placement.home"), decided())
    assert session.broken == ["answers_are_about_the_command"]


def test_what_people_were_told_is_in_the_journal(session: Session) -> None:
    session.watcher.answered(command(number="1"), decided())
    session.watcher.answered(command(number="2"), decided(decision="rejected", code="busy"))
    session.watcher.answered(command(number="3"), decided(decision="rejected", code="id_reused"))
    session.watcher.answered(command(number="4"), decided(decision="failed"))
    rows = {("bus:anna", "1"): "accepted", ("bus:anna", "4"): "failed"}
    session.watcher.check_rows(lambda source, number: rows.get((source, number)))
    assert session.broken == []
    rows["bus:anna", "4"] = "accepted"
    del rows["bus:anna", "1"]
    session.watcher.check_rows(lambda source, number: rows.get((source, number)))
    assert session.texts == [
        "1 was reported as accepted; the journal has None.",
        "4 was reported as failed; the journal has accepted.",
    ]


def test_a_second_datagram_is_soon_after_the_acknowledgement(session: Session) -> None:
    session.watcher.check_second_datagram(SECOND)
    assert session.broken == []
    session.watcher.check_second_datagram(SECOND + 0.01)
    assert session.broken == ["no_second_is_late"]


def test_good_poses_are_taken_again(session: Session) -> None:
    session.watcher.poses_end(fresh=True)
    assert session.broken == []
    session.watcher.poses_end(fresh=False)
    assert session.broken == ["poses_go_on"]
