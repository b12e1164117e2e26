"""What counts in a live tour: as required, otherwise than requested, refused by a check, or a deviation."""

from __future__ import annotations

import msgspec

from pcmrs.authoring.trial.tour import TourCommand, all_moves
from pcmrs.fsm.behaviour import Joint, joint_of
from pcmrs.messages import Reason
from pcmrs_lab.experiment.tours.progress import DECIDED_AT_ONCE, TourProgress
from tests.unit.lab.blueprints import small
from tests.unit.lab.scripted_client import verdict

MOVES = {
    joint: [msgspec.structs.replace(move, at="", how="") for move in there if move.how in ("", "refuses")]
    for joint, there in all_moves(small(), 1000).items()
}
"""As they are seen from outside: without the step that ends them."""
START = joint_of(small(), small().initial())


def progress() -> TourProgress:
    return TourProgress(small(), MOVES, {})


def move(name: str, ending: str, before: Joint = START) -> TourCommand:
    return next(each for each in MOVES[before] if (each.name, each.ending) == (name, ending))


def ready() -> Joint:
    """Joint state in which the side branch may move."""
    return next(
        joint for joint in MOVES if any(each.name == "side.move" and each.ending == "done" for each in MOVES[joint])
    )


def test_a_required_rejection_is_covered() -> None:
    tour, required = progress(), move("side.move", "rejected")
    tour.rejected(required, verdict("side.move", "rejected", required.code, sequence=4), 4, START)
    assert tour.seen.made == {required}
    assert tour.seen.deviations == []


def test_a_rejection_that_committed_something_deviates() -> None:
    tour, required = progress(), move("side.move", "rejected")
    tour.rejected(required, verdict("side.move", "rejected", required.code, sequence=5), 4, START)
    (found,) = tour.seen.deviations
    assert "yet something was committed" in found.found
    assert tour.seen.made == set()


def test_a_rejection_for_another_reason_deviates() -> None:
    tour, required = progress(), move("side.move", "rejected")
    tour.rejected(required, verdict("side.move", "rejected", "busy", sequence=4), 4, START)
    assert [each.command for each in tour.seen.deviations] == ["side.move:rejected"]


def test_a_refusing_check_is_no_deviation_but_not_covered_either() -> None:
    tour, wanted = progress(), move("side.move", "done", ready())
    reason = Reason(code="too_far", text="It is too far.", fields={"check": "in_reach"})
    for _ in range(3):  # as often as it is tried
        tour.rejected(wanted, verdict("side.move", "rejected", reason=reason), 1, wanted.before)
    assert (tour.seen.made, tour.seen.deviations) == (set(), [])
    assert tour.agenda.unseen()[wanted] == "refused by its check: too_far"


def test_another_ending_than_requested_one_is_covered_as_it_was() -> None:
    tour, wanted = progress(), move("side.move", "failed", ready())
    done = move("side.move", "done", ready())
    tour.ended(wanted, verdict("side.move"), done.after, ran=True)
    assert tour.seen.made == {done}
    assert wanted in tour.agenda.unseen()
    assert tour.seen.left == {}


def test_operation_decided_at_once_is_not_expected_to_fail() -> None:
    """Stop cannot come in between if it was accepted and was never shown as running."""
    tour, wanted = progress(), move("side.move", "failed", ready())
    tour.ended(wanted, verdict("side.move"), move("side.move", "done", ready()).after, ran=False)
    assert tour.seen.left[wanted] == DECIDED_AT_ONCE
    assert all(each.ending == "failed" and each.name == "side.move" for each in tour.seen.left)


def test_an_ending_in_joint_state_that_no_move_leads_to_deviates() -> None:
    tour, wanted = progress(), move("side.move", "done", ready())
    tour.ended(wanted, verdict("side.move"), START, ran=True)
    assert [each.command for each in tour.seen.deviations] == ["side.move:done"]


def test_move_that_deviates_after_it_was_covered_does_not_count() -> None:
    tour, wanted = progress(), move("side.move", "done", ready())
    tour.cover([wanted])
    tour.judge(wanted, "followed by an unrequested change", START, "")
    assert tour.seen.made == set()
    assert len(tour.seen.deviations) == 1


def test_what_is_dropped_is_left_with_its_reason() -> None:
    tour = progress()
    tour.drop(lambda each: each.name == "top.prepare", "nobody may ask for it")
    assert set(tour.seen.left.values()) == {"nobody may ask for it"}
    assert {each.name for each in tour.seen.left} == {"top.prepare"}
    assert not [each for each in tour.agenda.unseen() if each.name == "top.prepare"]
