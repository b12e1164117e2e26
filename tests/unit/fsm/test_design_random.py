"""Random step tables: the designed blueprint is sound and does what the table says, in every reachable state."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from random import Random
from typing import Any

import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.authoring.design import Design, design
from pcmrs.fsm import Blueprint, Closure, Engine, flags_of, parse_blueprint
from tests.support.trials import examples
from tests.unit.fsm.step_table_oracle import Model, random_table

RANDOMS = st.randoms(use_true_random=False)
Joint = dict[str, str]


def designed(table: dict[str, Any]) -> tuple[Design, Blueprint]:
    result = design(tomli_w.dumps(table).encode())
    assert not result.findings, (table, [str(finding) for finding in result.findings])
    return result, parse_blueprint(result.text.encode())


def endings(engine: Engine) -> Iterator[tuple[Joint, str, str, dict[str, Joint] | None]]:
    """Every reachable joint state with every operation that may be asked for, and where that leads, if anywhere."""
    waiting = [engine.joint()]
    seen = {tuple(waiting[0].values())}
    while waiting:
        joint = waiting.pop()
        for branch, spec in engine.blueprint.branches.items():
            for operation in (name for name, each in spec.operations.items() if not each.iio):
                engine.place(joint)
                answer = engine.ask(branch, operation)
                if not isinstance(answer, Closure):
                    yield joint, branch, operation, None
                    continue
                after = {name: dict(change.states) for name, change in answer.outcomes.items()}
                yield joint, branch, operation, after
                new = {tuple(each.values()): each for each in after.values()}
                waiting += [each for key, each in new.items() if key not in seen]
                seen |= set(new)


def possible_subsets(table: dict[str, Any]) -> set[frozenset[str]]:
    """The downward closed sets of level 1 steps, among all subsets."""
    needs = {step["name"]: set(step["depends_on"]) for step in table["steps"]}
    subsets = (
        {name for name, taken in zip(needs, bits, strict=True) if taken} for bits in product((0, 1), repeat=len(needs))
    )
    return {frozenset(subset) for subset in subsets if all(needs[name] <= subset for name in subset)}


def done_in(model: Model, flags: dict[str, bool]) -> set[str]:
    return {name for name, step in model.steps.items() if not step.below and flags[name]}


def expected(model: Model, done: set[str], spec_flags: list[str], operation: str, outcome: str) -> set[str] | None:
    return model.reinit(done, spec_flags) if operation == "reinit" else model.command(done, operation, outcome)


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


@examples(40)
@given(RANDOMS)
def test_impossible_combination_counts_at_first_missing_step(rng: Random) -> None:
    """It counts once, under the first dependency that it breaks."""
    table = random_table(rng, levels=1, steps=7)
    result, _ = designed(table)
    assert result.combinations is not None
    names = [step["name"] for step in table["steps"]]
    counted = dict.fromkeys(((each.step, each.missing) for each in result.combinations.impossible), 0)
    for bits in product((False, True), repeat=len(names)):
        has = dict(zip(names, bits, strict=True))
        first = next(((step, missing) for step, missing in counted if has[step] and not has[missing]), None)
        if first is not None:
            counted[first] += 1
    assert [each.count for each in result.combinations.impossible] == list(counted.values())
    assert result.combinations.possible + sum(counted.values()) == 2 ** len(names)


def started_by_rule_3(blueprint: Blueprint, model: Model, branch: str, before: Joint, after: Joint) -> set[str]:
    """Steps of the branches that start where a direct change of `branch` has led."""
    if before[branch] == after[branch]:
        return set()
    starting = {
        name
        for name, spec in blueprint.branches.items()
        if spec.parent and (spec.parent.branch, spec.parent.start) == (branch, after[branch])
    }
    refined = (step for step in model.steps.values() if f"inside_{step.name}" in starting)
    return set().union(*(step.leaves() for step in refined))


def begun(blueprint: Blueprint, joint: Joint) -> bool:
    """Whether a refinement is neither at its start nor complete."""
    return any(b.level > 1 and len(set(joint[name])) > 1 for name, b in blueprint.branches.items())


@pytest.mark.parametrize(("levels", "steps"), [(1, 5), (2, 3), (3, 2)])
@examples(15)
@given(rng=RANDOMS)
def test_a_table_does_what_a_set_of_steps_does(levels: int, steps: int, rng: Random) -> None:
    """Refused otherwise is only what would leave behind something that has begun."""
    table = random_table(rng, levels=levels, steps=steps)
    _, blueprint = designed(table)
    model = Model(table)
    for joint, branch, operation, after in endings(Engine(blueprint)):
        done = done_in(model, flags_of(blueprint, joint))
        refused = after is None and blueprint.branches[branch].operations[operation].requires
        if refused and begun(blueprint, joint):
            continue
        for outcome, states in (after or {"": {}}).items():
            wanted = expected(model, done, blueprint.branches[branch].flags, operation, outcome)
            if after is None or wanted is None:
                assert (after is None) == (wanted is None), (table, joint, branch, operation)
                continue
            found = done_in(model, flags_of(blueprint, states))
            lost = started_by_rule_3(blueprint, model, branch, joint, states)
            assert wanted - lost <= found <= wanted, (table, joint, branch, operation, outcome)
