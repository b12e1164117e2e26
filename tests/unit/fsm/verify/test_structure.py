"""Findings that follow from decisions alone, against the answers in every joint state."""

from __future__ import annotations

from random import Random

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm import Blueprint, Denial
from pcmrs.fsm.behaviour import behaviour
from pcmrs.fsm.blueprint import ActivitySpec
from pcmrs.fsm.closure import Closure, close
from pcmrs.fsm.verify import verify
from tests.support.altered import with_branch
from tests.support.trials import examples
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.verify.finding_oracle import States, answers, check, cut_short, found, joint_states


@given(blueprints(), st.randoms(use_true_random=False))
@examples(100)
def test_where_its_end_is_denied_it_is_stuck(blueprint: Blueprint, rng: Random) -> None:
    """Against the answers of every joint state, one by one."""
    name = rng.choice(list(blueprint.branches))
    branch = blueprint.branches[name]
    state, ended = rng.choice(list(branch.states)), rng.choice(list(branch.operations))
    with_one = with_branch(blueprint, name, activities={state: ActivitySpec(run="go_on", ended=ended)})
    found = verify(with_one).findings
    if branch.operations[ended].iio or {"endless_cascade", "no_outcome"} & {finding.code for finding in found}:
        return
    place = list(blueprint.branches).index(name)
    here = [answers for joint, answers in behaviour(blueprint).items() if joint[place] == state]
    stuck = any(isinstance(answers[f"{name}.{ended}"], Denial) for answers in here)
    assert [finding.path for finding in found if finding.code == "activity_stuck"] == (
        [("branches", name, "activities", state)] if stuck else []
    )


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
