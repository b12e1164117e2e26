"""Liveness of random workflows, against what is seen of them one joint state at a time."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm.behaviour import joint_of
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, Condition, OperationSpec, PropertySpec
from pcmrs.fsm.closure import Closure
from pcmrs.fsm.verify import verify
from pcmrs.fsm.verify.liveness import TimedOperations
from pcmrs.fsm.verify.space import Space
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.verify.finding_oracle import States, answers, check, cut_short, found
from tests.unit.fsm.verify.moment_oracle import lengths, stranded


@examples(40)
@given(blueprints())
def test_a_deadlock_is_found(blueprint: Blueprint) -> None:
    def stuck(states: States) -> bool:
        goal = blueprint.goal and all(states[name] in wanted for name, wanted in blueprint.goal.items())
        return not goal and not any(isinstance(each, Closure) for each in answers(blueprint, states, events=False))

    if not cut_short(blueprint):
        check(blueprint, found(blueprint, "deadlock"), stuck)


def test_a_procedure_that_has_ended_at_its_goal_is_not_stuck() -> None:
    states = {"begun": "begun", "ended": "ended"}
    branch = BranchSpec(states=states, operations={"end": OperationSpec(from_=["begun"], to="ended")})
    blueprint = Blueprint(id="ends", version="1.0.0", branches={"procedure": branch})
    assert [finding.code for finding in verify(blueprint).findings] == ["deadlock"]
    assert verify(msgspec.structs.replace(blueprint, goal={"procedure": ["ended"]})).findings == []


@examples(150)
@given(blueprints())
def test_a_goal_out_of_reach_is_found(blueprint: Blueprint) -> None:
    def lost(states: States) -> bool:
        ahead = _from(blueprint, states)
        return not any(all(each[name] in wanted for name, wanted in blueprint.goal.items()) for each in ahead)

    if cut_short(blueprint):
        return
    unreachable = lost(blueprint.initial())
    assert bool(found(blueprint, "goal_unreachable")) == unreachable
    if not unreachable:
        check(blueprint, found(blueprint, "goal_lost"), lost)


@pytest.mark.parametrize(
    ("operation", "code"),
    [
        (OperationSpec(from_=["b"], to="b", steps=["work"], on_unknown="c"), "goal_unreachable"),
        (OperationSpec(from_=["b"], to="b", steps=["work"], on_failure="c"), "goal_unreachable"),
        (OperationSpec(from_=["b"], to="c", event=True), "goal_unreachable"),
        (OperationSpec(from_=["b"], to="c"), None),
    ],
    ids=["doubt", "fault", "device", "intended"],
)
def test_a_dead_end_that_only_a_fault_or_a_device_leaves_is_one(operation: OperationSpec, code: str | None) -> None:
    go, stay = OperationSpec(from_=["a"], to="b"), OperationSpec(from_=["b"], to="b")
    branch = BranchSpec(states=dict.fromkeys("abc", "a state"), operations={"go": go, "stay": stay, "on": operation})
    promise = PropertySpec(
        id="leads", when=Condition(states={"main": ["b"]}), leads_to=Condition(states={"main": ["c"]})
    )
    blueprint = Blueprint(
        id="ends", version="1.0.0", branches={"main": branch}, goal={"main": ["c"]}, properties=[promise]
    )
    assert [finding.code for finding in verify(blueprint).findings] == ([code, "property_violated"] if code else [])


def _from(blueprint: Blueprint, start: States) -> list[States]:
    """Where what users ask for and what ends as declared can lead."""
    known, waiting = {joint_of(blueprint, start)}, [start]
    for states in waiting:
        for closure in answers(blueprint, states, events=False):
            for change in closure.outcomes.values() if isinstance(closure, Closure) else ():
                if joint_of(blueprint, change.states) not in known:
                    known.add(joint_of(blueprint, change.states))
                    waiting.append(dict(change.states))
    return waiting


@examples(40)
@given(blueprints(), st.data())
def test_operations_protected_by_locks_need_no_search(blueprint: Blueprint, data: st.DataObject) -> None:
    """Only operations that are called strandable can be found where they are denied."""
    runs = TimedOperations(Space(blueprint, 10_000))
    for branch, spec in blueprint.branches.items():
        for operation, declared in spec.operations.items():
            name = f"{branch}.{operation}"
            if declared.steps and name not in runs.strandable:
                found = lengths(blueprint, frozenset({name}))
                assert not any(stranded(blueprint, moment) for moment in found)
