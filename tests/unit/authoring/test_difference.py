"""Activities in a blueprint: what cannot be meant is named, and every view of a workflow shows them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from random import Random
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring import difference
from pcmrs.authoring.difference import BlueprintDifference, Kind, compare
from pcmrs.errors import BlueprintError
from pcmrs.fsm import Blueprint, BranchSpec, OperationSpec
from pcmrs.fsm.behaviour import Joint, Ruling, behaviour
from pcmrs.fsm.blueprint import Condition
from tests.support.altered import with_branch, with_operation
from tests.support.ratms_oracle import as_dict, expected, reachable
from tests.support.shipped import shipped_blueprint
from tests.support.trials import examples
from tests.unit.fsm.arm_workflow import arm_blueprint
from tests.unit.fsm.large_blueprints import free
from tests.unit.fsm.random_blueprints import blueprints


def test_a_difference_in_them_is_one_in_behaviour() -> None:
    near = arm_blueprint().branches["arm"].activities["near"]
    without = with_branch(arm_blueprint(), "arm", activities={"near": near})
    said = [found.text for found in compare(arm_blueprint(), without)]
    assert said == [
        "arm.[following]: activity changed from follow_head to None",
        "arm.[following]: ended by changed from lost to None",
        "arm.[following]: moves changed from True to None",
    ]
    near = msgspec.structs.replace(near, run="see_head")
    other = with_branch(arm_blueprint(), "arm", activities={**arm_blueprint().branches["arm"].activities, "near": near})
    assert [difference.subject for difference in compare(other, arm_blueprint())] == ["arm.[near]"]
    assert compare(arm_blueprint(), arm_blueprint()) == []


RATMS = shipped_blueprint("ratms")


@cache
def answers_of_ratms() -> dict[Joint, dict[str, Ruling]]:
    return behaviour(RATMS)


@pytest.fixture(autouse=True)
def ratms_is_asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of the time of a comparison goes into the answers of the same workflow."""
    monkeypatch.setattr(
        difference, "behaviour", lambda blueprint: answers_of_ratms() if blueprint is RATMS else behaviour(blueprint)
    )


MIRRORED: dict[Kind, Kind] = {
    "added": "removed",
    "removed": "added",
    "reached": "unreached",
    "unreached": "reached",
    "accepted": "rejected",
    "rejected": "accepted",
}


def shuffled(blueprint: Blueprint, rng: Random) -> Blueprint:
    """The same workflow with everything that has no order in another order."""

    def mixed(table: dict[str, Any]) -> dict[str, Any]:
        return {key: table[key] for key in rng.sample(list(table), len(table))}

    def operation(spec: OperationSpec) -> OperationSpec:
        return msgspec.structs.replace(spec, from_=rng.sample(spec.from_, len(spec.from_)), title="another")

    def branch(spec: BranchSpec) -> BranchSpec:
        first, *others = spec.states
        return msgspec.structs.replace(
            spec,
            states={first: "another meaning", **mixed({state: spec.states[state] for state in others})},
            operations=mixed({name: operation(declared) for name, declared in spec.operations.items()}),
        )

    branches = {name: branch(spec) for name, spec in blueprint.branches.items()}
    return msgspec.structs.replace(blueprint, branches=mixed(branches), version="another")


def seen(differences: list[BlueprintDifference]) -> set[tuple[str, str, int, str, str]]:
    return {(d.kind, d.subject, d.joint_states, d.old, d.new) for d in differences}


@given(blueprints())
@examples(25)
def test_a_workflow_does_not_differ_from_itself(blueprint: Blueprint) -> None:
    assert compare(blueprint, blueprint) == []


@given(st.randoms(use_true_random=False))
@examples(3)
def test_order_titles_and_version_are_no_behaviour(rng: Random) -> None:
    assert compare(RATMS, shuffled(RATMS, rng)) == []


def test_all_states_by_name_are_the_same_as_the_star() -> None:
    named = with_operation(RATMS, "toolplan", "plan", from_=["1", "0"])
    assert RATMS.branches["toolplan"].operations["plan"].from_ == ["*"]
    assert compare(RATMS, named) == []


@given(blueprints(), blueprints())
@examples(30)
def test_swapping_the_two_mirrors_the_differences(one: Blueprint, other: Blueprint) -> None:
    there, back = compare(one, other), compare(other, one)
    mirrored = {(MIRRORED.get(d.kind, d.kind), d.subject, d.joint_states, d.new, d.old) for d in there}
    assert mirrored == seen(back)


@cache
def mutants() -> dict[str, Blueprint]:
    return {f"{name}: {what}": mutant for name, what, mutant in _mutants()}


def _mutants() -> Iterator[tuple[str, str, Blueprint]]:
    for branch, branch_spec in RATMS.branches.items():
        for operation, spec in branch_spec.operations.items():
            name = f"{branch}.{operation}"
            for what, fields in _changes(branch_spec, spec):
                yield name, what, with_operation(RATMS, branch, operation, **fields)
    confirm = RATMS.branches["placement"].operations["confirm"]
    for what, fields in _declared(confirm):
        yield "placement.confirm", what, with_operation(RATMS, "placement", "confirm", **fields)


def _changes(branch: BranchSpec, spec: OperationSpec) -> Iterator[tuple[str, dict[str, Any]]]:
    valid = list(branch.states) if spec.from_ == ["*"] else spec.from_
    if not spec.iio:
        for state in valid:
            yield f"not from {state}", {"from_": [other for other in valid if other != state]}
    if spec.on_failure is not None:
        yield "fails elsewhere", {"on_failure": None}
        yield "doubted elsewhere", {"on_unknown": None}
    if isinstance(spec.to, str) and not spec.iio:
        others = [state for state in branch.states if state != spec.to]
        yield "leads elsewhere", {"to": others[0]}


def _declared(spec: OperationSpec) -> Iterator[tuple[str, dict[str, Any]]]:
    yield "another deadline", {"timeout_s": spec.timeout_s + 1}
    yield "a check more", {"checks": [*spec.checks, "another"]}
    yield "a role", {"roles": ["surgeon"]}
    yield "other arguments", {"payload": "other"}
    yield "the other way", {"motion": "retreat"}
    yield "releases the latch", {"unlatches": not spec.unlatches}
    yield "steps in another order", {"steps": spec.steps[::-1]}


def _of_each_kind() -> set[str]:
    """The first mutant of each kind of change in a root and in a child; the nightly run tries all others."""
    first: dict[tuple[bool, str], str] = {}
    for name in mutants():
        operation, _, what = name.partition(": ")
        nested = RATMS.branches[operation.partition(".")[0]].parent is not None
        first.setdefault((nested, what.partition(" from ")[0]), name)
    return set(first.values())


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in _of_each_kind() else pytest.mark.nightly) for name in mutants()],
)
def test_every_mutant_is_found_and_named(name: str) -> None:
    differences = compare(RATMS, mutants()[name])
    operation = name.partition(":")[0]
    assert any(d.subject.partition(":")[0] == operation for d in differences), differences


def test_newly_rejected_joint_states_match_the_specification() -> None:
    fewer = with_operation(RATMS, "placement", "home", from_=["standoff", "placed", "following", "guided", "replanned"])
    (rejected,) = (d for d in compare(RATMS, fewer) if d.kind == "rejected")
    lost = [joint for joint in reachable() if joint[4] == "retracted" and expected(joint, "placement", "home")]
    assert (rejected.subject, rejected.joint_states) == ("placement.home", len(lost))
    assert rejected.example in [as_dict(joint) for joint in lost]
    where = "robot=1 placement=retracted alignment=0 teleoperation=off"
    assert rejected.text == f"placement.home: no longer accepted in 8 joint states: {where}"


def test_new_reachable_state_is_reported() -> None:
    branch = RATMS.branches["toolplan"]
    states = {**branch.states, "2": "planned twice"}
    operations = {**branch.operations, "again": OperationSpec(from_=["1"], to="2")}
    more = with_branch(RATMS, "toolplan", states=states, flags=[], operations=operations)
    kinds = {(d.kind, d.subject) for d in compare(RATMS, more)}
    assert {("added", "toolplan.[2]"), ("added", "toolplan.again"), ("reached", "")} <= kinds
    assert ("changed", "toolplan") in kinds


def test_a_new_branch_changes_nothing_of_the_others() -> None:
    light = BranchSpec(states={"off": "", "on": ""}, operations={"switch": OperationSpec(from_=["off"], to="on")})
    more = msgspec.structs.replace(RATMS, branches={**RATMS.branches, "light": light})
    assert [(d.kind, d.subject) for d in compare(RATMS, more)] == [("added", "light")]
    assert [(d.kind, d.subject) for d in compare(more, RATMS)] == [("removed", "light")]


def test_a_branch_that_others_wait_for_shows_in_what_they_answer() -> None:
    light = BranchSpec(states={"off": "", "on": ""}, operations={"switch": OperationSpec(from_=["off"], to="on")})
    spec = RATMS.branches["placement"].operations["confirm"]
    lit = with_operation(RATMS, "placement", "confirm", requires={**spec.requires, "light": ["on"]})
    more = msgspec.structs.replace(lit, branches={**lit.branches, "light": light})
    found = {(d.kind, d.subject, d.joint_states) for d in compare(RATMS, more)}
    assert ("rejected", "placement.confirm", 1) in found


@pytest.mark.nightly
def test_workflows_that_are_too_large_are_refused() -> None:
    with pytest.raises(BlueprintError, match="over 20000 joint states"):
        compare(free(5, 8), RATMS)


def test_a_weaker_promise_is_a_difference() -> None:
    """Whoever reviews a change must not miss that a safety property has gone."""
    stop, *others = RATMS.properties
    assert {d.subject for d in compare(RATMS, msgspec.structs.replace(RATMS, properties=others))} == {
        f"property.{stop.id}"
    }
    weakened = msgspec.structs.replace(stop, when=Condition(states={"robot": ["0"]}))
    (changed,) = compare(RATMS, msgspec.structs.replace(RATMS, properties=[weakened, *others]))
    assert (changed.kind, changed.subject) == ("changed", f"property.{stop.id}")
    (goal,) = compare(RATMS, msgspec.structs.replace(RATMS, goal={"placement": ["standoff"]}))
    assert "goal changed" in goal.text
    assert (
        compare(
            RATMS,
            msgspec.structs.replace(
                RATMS, properties=[msgspec.structs.replace(p, text="in other words") for p in RATMS.properties]
            ),
        )
        == []
    )
