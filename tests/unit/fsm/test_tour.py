"""Test tours: each command follows from the one before, nothing is left out, and a wrong engine is found out."""

from __future__ import annotations

from collections import defaultdict
from functools import cache

import msgspec
import pytest
from hypothesis import given

from pcmrs.authoring.trial.coverage import coverage, is_complete
from pcmrs.authoring.trial.engine_tour import tour_engine
from pcmrs.authoring.trial.tour import Tour, TourCommand, plan_tour
from pcmrs.errors import BlueprintError
from pcmrs.fsm import Blueprint, BranchSpec, OperationSpec, load_blueprint
from pcmrs.fsm.blueprint import OutcomeSpec
from tests.support.altered import with_operation
from tests.support.ratms_oracle import BLUEPRINT, INTERNAL_OPERATIONS, all_operations, as_dict, expected, reachable
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints

RATMS = load_blueprint(BLUEPRINT)


@cache
def ratms_tour() -> Tour:
    return plan_tour(RATMS)


def check_connected(blueprint: Blueprint, tour: Tour) -> None:
    start = tuple(blueprint.initial().values())
    for stretch in tour.stretches:
        befores = [move.before for move in stretch]
        assert befores == [start, *(move.after for move in stretch)][: len(befores)]


def test_the_tour_of_ratms_wants_what_the_specification_says() -> None:
    found: dict[tuple[tuple[str, ...], str, str], dict[str, tuple[str, ...]]] = defaultdict(dict)
    for move in ratms_tour().wanted:
        if move.decision != "rejected":
            found[move.before, move.branch, move.operation][move.ending] = move.after
    assert {move.before for move in ratms_tour().wanted} == set(reachable())
    for joint in reachable():
        for branch, operation in all_operations():
            endings = expected(joint, branch, operation) or {}
            if not RATMS.branches[branch].operations[operation].steps:
                endings = {name: after for name, after in endings.items() if name not in ("failed", "unknown")}
            assert found[joint, branch, operation] == endings, (as_dict(joint), branch, operation)


def test_ratms_tour_asks_in_vain_where_the_specification_rejects() -> None:
    asked = {(m.before, m.branch, m.operation) for m in ratms_tour().wanted if m.decision == "rejected" and not m.at}
    internal = [(branch, name) for branch, names in INTERNAL_OPERATIONS.items() for name in names]
    for joint in reachable():
        rejected = [(b, o) for b, o in all_operations() if expected(joint, b, o) is None]
        assert {(joint, *which) for which in (*rejected, *internal)} <= asked


def test_ratms_tour_fails_every_step_and_refuses_every_check() -> None:
    made = {(m.branch, m.operation, m.decision, m.at, m.how) for stretch in ratms_tour().stretches for m in stretch}
    for branch, operation in all_operations():
        spec = RATMS.branches[branch].operations[operation]
        for how in ("refuses", "raises", "late"):
            assert all((branch, operation, "failed", step, how) in made for step in spec.steps)
        assert all((branch, operation, "unknown", step, "silent") in made for step in spec.steps)
        assert all((branch, operation, "rejected", check, "refuses") in made for check in spec.checks)


def test_the_tour_of_ratms_is_connected_complete_and_short() -> None:
    tour = ratms_tour()
    check_connected(RATMS, tour)
    moves = [move for stretch in tour.stretches for move in stretch]
    assert set(moves) == set(tour.wanted)
    assert len(tour.stretches) == 1
    assert len(moves) < 1.3 * len(tour.wanted)


@given(blueprints())
@examples(40)
def test_random_workflows_are_toured_completely(blueprint: Blueprint) -> None:
    tour = plan_tour(blueprint)
    check_connected(blueprint, tour)
    done = list(tour_engine(blueprint, tour))
    assert [deviation for _, deviation in done if deviation is not None] == []
    assert {move for move, _ in done} == set(tour.wanted)


def test_state_without_a_way_back_costs_a_restart() -> None:
    step = {"from_": ["start"], "steps": ["work"]}
    operations = {way: OperationSpec(to=way, **step) for way in ("left", "right")}  # type: ignore[arg-type]
    states = dict.fromkeys(("start", "left", "right"), "")
    blueprint = Blueprint(id="fork", version="1", branches={"way": BranchSpec(states=states, operations=operations)})
    tour = plan_tour(blueprint)
    check_connected(blueprint, tour)
    assert len(tour.stretches) == 2
    assert {move for stretch in tour.stretches for move in stretch} == set(tour.wanted)


@pytest.mark.parametrize(
    ("branch", "operation", "fields"),
    [
        ("placement", "confirm", {"from_": ["standoff", "retracted"]}),
        ("placement", "home", {"from_": ["standoff", "placed", "following"]}),
        ("placement", "approach", {"on_failure": None}),
        ("placement", "approach", {"on_unknown": "held"}),
        ("registration", "register", {"to": "110"}),
        ("registration", "reinit", {"requires": {}}),
        ("registration", "use_previous", {"sets": {}}),
        ("robot", "link_lost", {"to": "1"}),
        ("toolplan", "reinit", {"refusal": "another_code"}),
    ],
)
def test_an_engine_that_runs_something_else_deviates(branch: str, operation: str, fields: dict[str, object]) -> None:
    done = list(tour_engine(with_operation(RATMS, branch, operation, **fields), ratms_tour()))
    assert any(deviation is not None and f"{branch}.{operation}" in str(deviation) for _, deviation in done)


def test_coverage_counts_what_is_missing() -> None:
    moves = [move for stretch in ratms_tour().stretches for move in stretch]
    assert is_complete(coverage(RATMS, moves, ratms_tour().wanted))
    without = [move for move in moves if move.name != "placement.confirm"]
    counts = coverage(RATMS, without, ratms_tour().wanted)
    assert counts["pairs"].total - counts["pairs"].covered == len(reachable())
    assert counts["accepted"].total - counts["accepted"].covered == 1
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


def test_a_workflow_with_too_many_joint_states_is_refused() -> None:
    with pytest.raises(BlueprintError, match="over 33 joint states"):
        plan_tour(RATMS, limit=33)
    assert plan_tour(RATMS, limit=39).wanted


def test_moves_survive_json() -> None:
    for move in ratms_tour().wanted[::50]:
        assert msgspec.json.decode(msgspec.json.encode(move), type=TourCommand) == move
