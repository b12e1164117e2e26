"""The combinations of steps that respect all dependencies, and what a step opens again."""

from __future__ import annotations

from itertools import product
from random import Random
from typing import Any

import pytest
from hypothesis import given

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
