"""The combinations of steps that respect all dependencies, and what a step opens again."""

from __future__ import annotations

from itertools import product
from random import Random
from typing import Any

import msgspec
import pytest
from hypothesis import given

from pcmrs.authoring.design._order import MAX_COMBINATIONS, Order, TooManyCombinationsError
from pcmrs.authoring.design.tables import StepSpec
from pcmrs.fsm import Engine, flags_of
from tests.support.trials import examples
from tests.unit.authoring.design.designed_tables import RANDOMS, designed, endings
from tests.unit.authoring.design.step_table_oracle import random_table


def possible_subsets(table: dict[str, Any]) -> set[frozenset[str]]:
    """The downward closed sets of level 1 steps, among all subsets."""
    needs = {step["name"]: set(step["depends_on"]) for step in table["steps"]}
    subsets = (
        {name for name, taken in zip(needs, bits, strict=True) if taken} for bits in product((0, 1), repeat=len(needs))
    )
    return {frozenset(subset) for subset in subsets if all(needs[name] <= subset for name in subset)}


@examples(40)
@given(RANDOMS)
@pytest.mark.nightly
def test_joint_states_of_level_1_are_the_downward_closed_sets(rng: Random) -> None:
    table = random_table(rng, levels=1, steps=6)
    result, blueprint = designed(table)
    subsets = possible_subsets(table)
    reached = {
        frozenset(name for name, flag in flags_of(blueprint, joint).items() if flag)
        for joint, *_ in endings(Engine(blueprint))
    }
    assert reached == subsets
    assert result.combinations is not None
    assert result.combinations.possible == len(subsets)
    assert result.combinations.steps == len(table["steps"])


def order_of(table: dict[str, Any]) -> Order:
    return Order(msgspec.convert(table["steps"], list[StepSpec]))


@examples(40)
@given(RANDOMS)
def test_ideals_are_the_subsets_with_all_their_dependencies(rng: Random) -> None:
    table = random_table(rng, levels=1, steps=6)
    order = order_of(table)
    found = {frozenset(order.steps[i].name for i in range(len(order)) if each >> i & 1) for each in order.ideals}
    assert found == possible_subsets(table)
    assert len(order.ideals) == len(found)
    assert (order.ideals[0], max(order.ideals)) == (0, order.all)


@examples(40)
@given(RANDOMS)
def test_doing_and_taking_back_lead_from_ideal_to_ideal(rng: Random) -> None:
    order = order_of(random_table(rng, levels=1, steps=6))
    ideals = set(order.ideals)
    for step in range(len(order)):
        assert order.first_possible(step) == min(order.possible_at(step), key=int.bit_count)
        for each in order.ideals:
            assert order.reopen(step, each) in ideals
            if order.possible(step, each):
                assert order.achieve(step, each) in ideals
                assert order.reopen(step, order.achieve(step, each)) == order.reopen(step, each)


def test_too_few_dependencies_make_no_branch() -> None:
    free = [StepSpec(name=f"s{i}", operation=f"do_{i}") for i in range(13)]
    assert len(Order(free[:12]).ideals) == 2**12 == MAX_COMBINATIONS
    with pytest.raises(TooManyCombinationsError):
        Order(free)
