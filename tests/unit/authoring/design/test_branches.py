"""Branches of a design: the steps of a group, then what refines them, each below the branch of its step."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.authoring.design._branches import root_branches
from pcmrs.authoring.design._grouping import UndesignableError
from tests.unit.authoring.design.step_tables import converted, step

INNERMOST = {"branch": "innermost", "steps": [step("q1"), step("q2", "q1")]}
INNER = {"branch": "inner", "steps": [step("p", refined_by=INNERMOST)]}


def test_each_refinement_follows_the_branch_that_it_refines() -> None:
    points = {"branch": "points", "points": 3}
    (group,), paths = converted(
        step("a", refined_by=INNER), step("b", "a", steps=["work"], refined_by=points), step("c", "b")
    )
    branches = list(root_branches(group, paths))
    parents = {each.name: each.spec.parent.branch if each.spec.parent else None for each in branches}
    assert parents == {"procedure": None, "inner": "procedure", "innermost": "inner", "points": "procedure"}
    assert list(parents) == ["procedure", "inner", "innermost", "points"]
    assert [each.spec.level for each in branches] == [1, 2, 3, 2]
    assert [".".join(each.path) for each in branches] == [
        "steps.0",
        "steps.0.refined_by.steps.0",
        "steps.0.refined_by.steps.0.refined_by.steps.0",
        "steps.1",
    ]


def test_states_are_the_possible_combinations_of_steps() -> None:
    (group,), paths = converted(step("a"), step("b", "a"), step("c", "a"))
    (branch,) = root_branches(group, paths)
    assert next(iter(branch.spec.states)) == "000"
    assert set(branch.spec.states) == {"000", "100", "110", "101", "111"}
    assert branch.spec.flags == ["a", "b", "c"]
    assert branch.spec.states["101"] == "a, c"
    assert branch.spec.revocations == []


def test_a_lost_robot_leaves_unknown_what_was_at_the_patient() -> None:
    """Digits: a, b moves, stopped."""
    (group,), paths = converted(step("a"), step("b", "a", moves=True, steps=["move"]))
    (branch,) = root_branches(group, paths)
    assert [(rule.by, rule.from_, rule.to) for rule in branch.spec.revocations] == [(["robot"], ["110"], "101")]


@pytest.mark.parametrize("reopened_by", [["do_a"], ["reinit"]])
def test_operations_that_collide_make_no_branch(reopened_by: list[Any]) -> None:
    (group,), paths = converted(step("a", reopened_by=reopened_by))
    with pytest.raises(UndesignableError, match="two different operations") as refused:
        list(root_branches(group, paths))
    assert refused.value.finding.code == "name_collision"
