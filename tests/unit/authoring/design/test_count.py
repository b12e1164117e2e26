"""Number of combinations of steps, and tables that make too large a blueprint."""

from __future__ import annotations

from itertools import product
from random import Random
from typing import Any

import pytest
from hypothesis import given

from pcmrs.authoring.design import design
from pcmrs.authoring.design._branches import DesignedBranch
from pcmrs.authoring.design._count import excess_of
from pcmrs.fsm import Blueprint, examine
from pcmrs.fsm.blueprint import BranchSpec, SequenceSpec
from pcmrs.fsm.files.load import BlueprintExamination
from pcmrs.fsm.finding import Finding
from tests.support.trials import examples
from tests.unit.authoring.design.designed_tables import RANDOMS, designed
from tests.unit.authoring.design.step_table_oracle import random_table
from tests.unit.authoring.design.step_tables import RATMS_STEPS, step, table


def test_the_papers_table_has_8_of_16_combinations() -> None:
    result = design(RATMS_STEPS)
    assert str(result.combinations) == (
        "8 of the 16 combinations of 4 steps are possible.\n"
        "  4 have landmarks_digitized without landmarks_planned.\n"
        "  4 have registered without landmarks_digitized."
    )
    assert examine(result.text.encode()).joint_states == 8


def test_many_steps_are_counted_without_being_listed() -> None:
    chain = [step(f"s{i}", *([f"s{i - 1}"] if i else [])) for i in range(30)]
    result = design(table(*chain, step("x", branch="apart")))
    assert result.combinations is not None
    assert (result.combinations.steps, result.combinations.possible) == (31, 62)
    assert result.combinations.possible + sum(each.count for each in result.combinations.impossible) == 2**31


def refined(number: int, points: int) -> list[dict[str, Any]]:
    """Steps of points each."""
    return [step(f"s{i}", steps=["s"], refined_by={"branch": f"b{i}", "points": points + i % 2}) for i in range(number)]


@pytest.mark.parametrize(
    ("raw", "said", "where"),
    [
        (
            table(*refined(11, 990)),
            "10895 items; the limit is 10000. Most is from b1, with 991 points.",
            b"points = 991",
        ),
        (
            table(step("root"), *(step(f"s{i}", "root") for i in range(10))),
            "Most is from procedure, with 1025 states.",
            b"[[steps]]",
        ),
    ],
)
def test_too_large_a_blueprint_is_reported_at_the_causing_step(raw: bytes, said: str, where: bytes) -> None:
    result = design(raw)
    assert [finding.code for finding in result.findings] == ["step_count"]
    assert raw.splitlines()[result.findings[0].line - 1] == where
    assert said in result.findings[0].text
    assert result.combinations is not None


def test_too_many_joint_states_are_reported_at_the_excess_points() -> None:
    path = ("steps", "0")
    branches = [
        DesignedBranch("b", BranchSpec(sequence=SequenceSpec(count=9)), path),
        DesignedBranch("a", BranchSpec(), path),
    ]
    examination = BlueprintExamination(
        Blueprint(id="x", version="1", branches={}), [Finding(code="too_many_states", text="Much.")]
    )
    excess = excess_of(examination, 1, branches)
    assert excess == Finding(
        code="step_count", text="Much. Most is from b, with 9 points.", path=(*path, "refined_by", "points")
    )


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
