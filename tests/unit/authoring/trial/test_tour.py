"""Test tours: each command follows from the one before, and nothing is left out."""

from __future__ import annotations

from collections import defaultdict

import msgspec
import pytest

from pcmrs.authoring.trial.tour import TourCommand, plan_tour
from pcmrs.errors import BlueprintError
from pcmrs.fsm import Blueprint, BranchSpec, OperationSpec
from tests.support.altered import with_branch
from tests.support.ratms_oracle import INTERNAL_OPERATIONS, all_operations, as_dict, expected, reachable
from tests.unit.authoring.trial.ratms_tour import RATMS, check_connected, ratms_tour
from tests.unit.fsm.arm_workflow import arm_blueprint


def test_a_tour_covers_a_workflow_that_has_them() -> None:
    still = with_branch(arm_blueprint(), "arm", activities={})
    assert plan_tour(arm_blueprint()) == plan_tour(still)


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


def test_state_without_a_way_back_costs_a_restart() -> None:
    step = {"from_": ["start"], "steps": ["work"]}
    operations = {way: OperationSpec(to=way, **step) for way in ("left", "right")}  # type: ignore[arg-type]
    states = dict.fromkeys(("start", "left", "right"), "")
    blueprint = Blueprint(id="fork", version="1", branches={"way": BranchSpec(states=states, operations=operations)})
    tour = plan_tour(blueprint)
    check_connected(blueprint, tour)
    assert len(tour.stretches) == 2
    assert {move for stretch in tour.stretches for move in stretch} == set(tour.wanted)


def test_a_workflow_with_too_many_joint_states_is_refused() -> None:
    with pytest.raises(BlueprintError, match="over 33 joint states"):
        plan_tour(RATMS, limit=33)
    assert plan_tour(RATMS, limit=40).wanted


def test_moves_survive_json() -> None:
    for move in ratms_tour().wanted[::50]:
        assert msgspec.json.decode(msgspec.json.encode(move), type=TourCommand) == move
