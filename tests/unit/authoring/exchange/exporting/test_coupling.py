"""Branches that an operation reads or moves: no other branch matters to its answer."""

from __future__ import annotations

from collections import defaultdict

import pytest
from hypothesis import given

from pcmrs.authoring.exchange.exporting.coupling import MAX_COMBINATIONS, ancestors, combinations, coupled
from pcmrs.errors import BlueprintError
from pcmrs.fsm.behaviour import branch_states, operations
from pcmrs.fsm.blueprint import Blueprint
from pcmrs.fsm.closure import Closure, close
from tests.support.trials import examples
from tests.unit.fsm.large_blueprints import free
from tests.unit.fsm.random_blueprints import blueprints
from tests.unit.fsm.verify.joint_state_oracle import essence, levels


@examples(40)
@given(blueprints())
def test_an_answer_depends_on_coupled_branches_only(blueprint: Blueprint) -> None:
    everywhere = [branch_states(blueprint, joint) for joint in levels(blueprint)]
    for branch, operation, _ in operations(blueprint):
        near = coupled(blueprint, branch, operation)
        answers = defaultdict(list)
        for states in everywhere:
            answer = close(blueprint, states, branch, operation)
            answers[tuple(states[name] for name in near)].append(essence(answer))
            if isinstance(answer, Closure):
                assert answer.writes <= set(near)
        assert all(answer == alike[0] for alike in answers.values() for answer in alike)


@examples(40)
@given(blueprints())
def test_combinations_are_those_in_which_children_fit(blueprint: Blueprint) -> None:
    found = list(combinations(blueprint, list(blueprint.branches)))
    assert len({tuple(joint.values()) for joint in found}) == len(found)
    reached = [branch_states(blueprint, joint) for joint in levels(blueprint)]
    assert all(joint in found for joint in reached)
    for joint in found:
        for name, branch in blueprint.branches.items():
            above = branch.parent
            assert above is None or joint[above.branch] in above.compatible[joint[name]]


@examples(40)
@given(blueprints())
def test_each_ancestor_is_one_level_above(blueprint: Blueprint) -> None:
    for name, branch in blueprint.branches.items():
        levels_above = [blueprint.branches[each].level for each in ancestors(blueprint, name)]
        assert levels_above == list(range(branch.level - 1, 0, -1))


def test_too_many_combinations_are_refused_unlisted() -> None:
    blueprint = free(20, 10)
    with pytest.raises(BlueprintError, match="depend on each other") as refused:
        next(combinations(blueprint, list(blueprint.branches)))
    assert refused.value.fields == {"combinations": 10**20, "limit": MAX_COMBINATIONS}
