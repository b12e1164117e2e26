"""Branches that an operation reads or moves: no other branch matters to its answer."""

from __future__ import annotations

import itertools
from collections import defaultdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.exchange.exporting._coupling import MAX_COMBINATIONS, ancestors, combinations, coupled
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
@given(blueprints(), st.data())
def test_combinations_are_those_in_which_children_fit(blueprint: Blueprint, data: st.DataObject) -> None:
    """In the order of branches and states; branches that are not asked for are at their start."""
    branches = data.draw(st.lists(st.sampled_from(list(blueprint.branches)), unique=True))

    def fits(joint: dict[str, str]) -> bool:
        parents = {name: blueprint.branches[name].parent for name in branches}
        return all(above is None or joint[above.branch] in above.compatible[joint[n]] for n, above in parents.items())

    product = itertools.product(*(blueprint.branches[name].states for name in branches))
    every = [blueprint.initial() | dict(zip(branches, states, strict=True)) for states in product]
    assert list(combinations(blueprint, branches)) == [joint for joint in every if fits(joint)]


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
