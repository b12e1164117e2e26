"""Every finding on random workflows, against what can be seen of them one joint state at a time."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
from hypothesis import given, settings
from random_blueprints import blueprints
from replay import replayed
from test_verify_search import levels, successors

from pcmrs.fsm.behaviour import answer, branch_states
from pcmrs.fsm.blueprint import Blueprint, BranchSpec, OperationSpec
from pcmrs.fsm.closure import Closure
from pcmrs.fsm.codes import VERIFICATION
from pcmrs.fsm.finding import Finding
from pcmrs.fsm.rules import check_rules
from pcmrs.fsm.verify import verify

States = dict[str, str]


def found(blueprint: Blueprint, code: str) -> list[Finding]:
    return [finding for finding in verify(blueprint).findings if finding.code == code]


def joint_states(blueprint: Blueprint) -> dict[int, list[States]]:
    """The reachable joint states by the length of the shortest way there."""
    by_length: dict[int, list[States]] = {}
    for joint, length in levels(blueprint).items():
        by_length.setdefault(length, []).append(branch_states(blueprint, joint))
    return by_length


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
        assert wanted(replayed(blueprint, commands[: len(commands) - extra]).states)


@settings(max_examples=40)
@given(blueprints())
def test_the_workflows_obey_the_static_rules_and_findings_are_of_known_kinds(blueprint: Blueprint) -> None:
    assert list(check_rules(blueprint)) == []
    assert {finding.code for finding in verify(blueprint).findings} <= set(VERIFICATION)


@settings(max_examples=40)
@given(blueprints())
def test_children_fit_their_parents_in_every_joint_state(blueprint: Blueprint) -> None:
    for states in (branch_states(blueprint, joint) for joint in levels(blueprint)):
        for name, branch in blueprint.branches.items():
            parent = branch.parent
            assert parent is None or states[parent.branch] in parent.compatible[states[name]]


@settings(max_examples=40)
@given(blueprints())
def test_a_deadlock_is_found(blueprint: Blueprint) -> None:
    def stuck(states: States) -> bool:
        goal = blueprint.goal and all(states[name] in wanted for name, wanted in blueprint.goal.items())
        asked = (
            answer(blueprint, states, name, operation)
            for name, branch in blueprint.branches.items()
            for operation, spec in branch.operations.items()
            if not spec.iio and not spec.event
        )
        return not goal and not any(isinstance(each, Closure) for each in asked)

    check(blueprint, found(blueprint, "deadlock"), stuck)


def test_a_procedure_that_has_ended_at_its_goal_is_not_stuck() -> None:
    states = {"begun": "begun", "ended": "ended"}
    branch = BranchSpec(states=states, operations={"end": OperationSpec(from_=["begun"], to="ended")})
    blueprint = Blueprint(id="ends", version="1.0.0", branches={"procedure": branch})
    assert [finding.code for finding in verify(blueprint).findings] == ["deadlock"]
    assert verify(msgspec.structs.replace(blueprint, goal={"procedure": ["ended"]})).findings == []


@settings(max_examples=40)
@given(blueprints())
def test_a_goal_out_of_reach_is_found(blueprint: Blueprint) -> None:
    def reached(states: States) -> bool:
        return all(states[name] in wanted for name, wanted in blueprint.goal.items())

    everywhere = [states for found in joint_states(blueprint).values() for states in found]
    assert bool(found(blueprint, "goal_unreachable")) == (not any(map(reached, everywhere)))
    lost = found(blueprint, "goal_lost")
    if any(map(reached, everywhere)):
        check(blueprint, lost, lambda states: not any(map(reached, _from(blueprint, states))))


@settings(max_examples=40)
@given(blueprints())
def test_denials_that_have_no_reason_are_found(blueprint: Blueprint) -> None:
    for code, denied in (("endless_cascade", "cascade_too_long"), ("no_outcome", "no_outcome")):

        def unsound(states: States, denied: str = denied) -> bool:
            answers = (
                answer(blueprint, states, name, operation)
                for name, branch in blueprint.branches.items()
                for operation, spec in branch.operations.items()
                if not spec.iio
            )
            return any(not isinstance(each, Closure) and each.code == denied for each in answers)

        check(blueprint, found(blueprint, code), unsound, extra=1)


@settings(max_examples=40)
@given(blueprints())
def test_what_is_never_used_is_found(blueprint: Blueprint) -> None:
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
        and not any(isinstance(answer(blueprint, states, name, operation), Closure) for states in everywhere)
    }
    assert {finding.path for finding in found(blueprint, "never_accepted")} == unaccepted


def _from(blueprint: Blueprint, start: States) -> list[States]:
    joint = tuple(start.values())
    known, waiting = {joint}, [joint]
    for each in waiting:
        new = set(successors(blueprint, each)) - known
        known |= new
        waiting.extend(new)
    return [branch_states(blueprint, each) for each in known]
