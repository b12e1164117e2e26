"""Coverage of a tour: what is missing is counted."""

from __future__ import annotations

from pcmrs.authoring.trial.coverage import coverage, is_complete
from pcmrs.authoring.trial.tour import plan_tour
from pcmrs.fsm import Blueprint, BranchSpec, OperationSpec
from pcmrs.fsm.blueprint import OutcomeSpec
from tests.support.ratms_oracle import expected, reachable
from tests.unit.authoring.trial.ratms_tour import RATMS, ratms_tour


def test_coverage_counts_what_is_missing() -> None:
    moves = [move for stretch in ratms_tour().stretches for move in stretch]
    assert is_complete(coverage(RATMS, moves, ratms_tour().wanted))
    without = [move for move in moves if move.name != "placement.confirm"]
    counts = coverage(RATMS, without, ratms_tour().wanted)
    assert counts["pairs"].total - counts["pairs"].covered == len(reachable())
    accepting = [joint for joint in reachable() if expected(joint, "placement", "confirm")]
    assert counts["accepted"].total - counts["accepted"].covered == len(accepting) == 3
    assert counts["outcomes"].total - counts["outcomes"].covered == 1
    assert not is_complete(counts)


def test_an_outcome_that_no_joint_state_gives_stays_uncovered() -> None:
    ends = {"well": OutcomeSpec(to="end"), "never": OutcomeSpec(to="end", requires={"way": ["end"]})}
    operations = {"go": OperationSpec(from_=["start"], outcomes=ends, steps=["work"])}
    states = dict.fromkeys(("start", "end"), "")
    blueprint = Blueprint(id="never", version="1", branches={"way": BranchSpec(states=states, operations=operations)})
    tour = plan_tour(blueprint)
    counts = coverage(blueprint, tour.wanted, tour.wanted)
    assert (counts["outcomes"].covered, counts["outcomes"].total) == (1, 2)
