"""Every finding on random workflows, against what can be seen of them one joint state at a time."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest
from hypothesis import given

from pcmrs.fsm.behaviour import Ruling, branch_states, joint_of
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, Condition, OperationSpec, PropertySpec
from pcmrs.fsm.closure import Closure, close
from pcmrs.fsm.codes import VERIFICATION
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.rules import check_rules
from pcmrs.fsm.verify import verify
from tests.support.trials import examples
from tests.unit.fsm.command_trace import follow_commands
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.test_verify_search import levels

States = dict[str, str]


def found(blueprint: Blueprint, code: str) -> list[Finding]:
    return [finding for finding in verify(blueprint).findings if finding.code == code]


def joint_states(blueprint: Blueprint) -> dict[int, list[States]]:
    """The reachable joint states by the length of the shortest way there."""
    by_length: dict[int, list[States]] = {}
    for joint, length in levels(blueprint).items():
        by_length.setdefault(length, []).append(branch_states(blueprint, joint))
    return by_length


def cut_short(blueprint: Blueprint) -> bool:
    """Something goes on without an end, or cannot end: what cannot be reached then says nothing."""
    return any(
        not isinstance(each, Closure) and each.code in ("cascade_too_long", "no_outcome")
        for states in (branch_states(blueprint, joint) for joint in levels(blueprint))
        for each in answers(blueprint, states)
    )


def answers(blueprint: Blueprint, states: States, *, events: bool = True) -> list[Ruling]:
    """What is answered to everything that may be asked for from outside."""
    return [
        close(blueprint, states, name, operation)
        for name, branch in blueprint.branches.items()
        for operation, spec in branch.operations.items()
        if not spec.iio and (events or not spec.event)
    ]


def shortest(blueprint: Blueprint, wanted: Callable[[States], bool]) -> int | None:
    lengths = (length for length, found in joint_states(blueprint).items() if any(map(wanted, found)))
    return min(lengths, default=None)


def check(blueprint: Blueprint, findings: list[Finding], wanted: Callable[[States], bool], extra: int = 0) -> None:
    """The finding is there exactly when it should be, and its commands are a shortest way into it."""
    length = shortest(blueprint, wanted)
    assert bool(findings) == (length is not None)
    lengths = [len(finding.commands or ()) - extra for finding in findings]
    assert min(lengths, default=None) == length
    for finding in findings:
        commands = finding.commands or ()
        assert wanted(follow_commands(blueprint, commands[: len(commands) - extra]).states)


@examples(40)
@given(blueprints())
def test_workflows_obey_static_rules_and_finding_codes_are_known(blueprint: Blueprint) -> None:
    assert list(check_rules(blueprint)) == []
    assert {finding.code for finding in verify(blueprint).findings} <= set(VERIFICATION)


@examples(40)
@given(blueprints())
def test_children_fit_their_parents_in_every_joint_state(blueprint: Blueprint) -> None:
    for states in (branch_states(blueprint, joint) for joint in levels(blueprint)):
        for name, branch in blueprint.branches.items():
            parent = branch.parent
            assert parent is None or states[parent.branch] in parent.compatible[states[name]]


@examples(40)
@given(blueprints())
def test_a_deadlock_is_found(blueprint: Blueprint) -> None:
    def stuck(states: States) -> bool:
        goal = blueprint.goal and all(states[name] in wanted for name, wanted in blueprint.goal.items())
        return not goal and not any(isinstance(each, Closure) for each in answers(blueprint, states, events=False))

    if not cut_short(blueprint):
        check(blueprint, found(blueprint, "deadlock"), stuck)


@examples(40)
@given(blueprints())
def test_fault_that_cuts_the_search_short_is_the_only_finding(blueprint: Blueprint) -> None:
    local = {"endless_cascade", "no_outcome", "ambiguous_revocation", "order_dependent"}
    if cut_short(blueprint):
        promise = PropertySpec(id="promise", never=Condition())
        found = verify(msgspec.structs.replace(blueprint, properties=[promise])).findings
        assert {finding.code for finding in found} <= local
        assert found


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


@examples(40)
@given(blueprints())
def test_denials_that_have_no_reason_are_found(blueprint: Blueprint) -> None:
    for code, denied in (("endless_cascade", "cascade_too_long"), ("no_outcome", "no_outcome")):

        def unsound(states: States, denied: str = denied) -> bool:
            return any(not isinstance(each, Closure) and each.code == denied for each in answers(blueprint, states))

        check(blueprint, found(blueprint, code), unsound, extra=1)


@examples(40)
@given(blueprints())
def test_unused_states_and_operations_are_found(blueprint: Blueprint) -> None:
    if cut_short(blueprint):
        return
    everywhere = [states for found in joint_states(blueprint).values() for states in found]
    unreached = {
        ("branches", name, "states", state)
        for name, branch in blueprint.branches.items()
        for state in branch.states
        if not any(states[name] == state for states in everywhere)
    }
    assert {finding.path for finding in found(blueprint, "unreachable_state")} == unreached
    unaccepted = {
        ("branches", name, "operations", operation)
        for name, branch in blueprint.branches.items()
        for operation, spec in branch.operations.items()
        if not spec.iio
        and not any(isinstance(close(blueprint, states, name, operation), Closure) for states in everywhere)
    }
    assert {finding.path for finding in found(blueprint, "never_accepted")} == unaccepted


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
