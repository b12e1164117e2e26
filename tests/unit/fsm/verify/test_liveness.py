"""Liveness of random workflows, against what is seen of them one joint state at a time."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm.behaviour import branch_states, joint_of
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, Condition, OperationSpec, PropertySpec
from pcmrs.fsm.closure import Closure
from pcmrs.fsm.verify import verify
from pcmrs.fsm.verify._liveness import TimedOperations
from pcmrs.fsm.verify._space import StateSpace
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.verify.finding_oracle import States, answers, check, cut_short, found
from tests.unit.fsm.verify.joint_state_oracle import Joint, levels
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


@examples(50)
@given(blueprints(), st.data())
def test_a_goal_out_of_reach_is_found(blueprint: Blueprint, data: st.DataObject) -> None:
    named = data.draw(st.lists(st.sampled_from(list(blueprint.branches)), min_size=1, max_size=2, unique=True))
    states = {name: st.sampled_from(list(blueprint.branches[name].states)) for name in named}
    goal = {name: data.draw(st.lists(states[name], min_size=1, unique=True)) for name in named}
    blueprint = msgspec.structs.replace(blueprint, goal=goal)
    if cut_short(blueprint):
        return
    hopeful = _leading_to_the_goal(blueprint)

    def lost(states: States) -> bool:
        return joint_of(blueprint, states) not in hopeful

    unreachable = lost(blueprint.initial())
    findings = verify(blueprint).findings
    assert any(finding.code == "goal_unreachable" for finding in findings) == unreachable
    if not unreachable:
        check(blueprint, [finding for finding in findings if finding.code == "goal_lost"], lost)


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


def _leading_to_the_goal(blueprint: Blueprint) -> set[Joint]:
    """Reachable joint states from which what users ask for, and ends as declared, can lead to the goal."""
    following = {
        joint: {
            joint_of(blueprint, change.states)
            for closure in answers(blueprint, branch_states(blueprint, joint), events=False)
            for change in (closure.outcomes.values() if isinstance(closure, Closure) else ())
        }
        for joint in levels(blueprint)
    }
    places = {list(blueprint.branches).index(name): wanted for name, wanted in blueprint.goal.items()}
    found = {joint for joint in following if all(joint[place] in wanted for place, wanted in places.items())}
    while more := {joint for joint in following.keys() - found if following[joint] & found}:
        found |= more
    return found


@examples(40)
@given(blueprints(), st.data())
def test_operations_protected_by_locks_need_no_search(blueprint: Blueprint, data: st.DataObject) -> None:
    """Only operations that are called strandable can be found where they are denied."""
    runs = TimedOperations(StateSpace(blueprint, 10_000))
    for branch, spec in blueprint.branches.items():
        for operation, declared in spec.operations.items():
            name = f"{branch}.{operation}"
            if declared.steps and name not in runs.strandable:
                found = lengths(blueprint, frozenset({name}))
                assert not any(stranded(blueprint, moment) for moment in found)
