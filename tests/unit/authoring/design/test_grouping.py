"""Steps that are connected share a branch."""

from __future__ import annotations

from tests.unit.authoring.design.step_tables import blueprint_of, step, table


def test_independent_chains_are_parallel_branches() -> None:
    blueprint = blueprint_of(table(step("a"), step("x"), step("b", "a", title="Bee"), step("y", "x", branch="other")))
    assert {name: list(branch.states) for name, branch in blueprint.branches.items()} == {
        "procedure": ["00", "10", "11"],
        "other": ["00", "10", "11"],
    }
    assert blueprint.branches["procedure"].flags == ["a", "b"]
    assert blueprint.branches["procedure"].states["11"] == "a, Bee"
    assert blueprint.goal == {"procedure": ["11"], "other": ["11"]}


def test_no_branch_takes_the_name_of_a_step() -> None:
    blueprint = blueprint_of(table(step("a"), step("x"), step("b", "a")))
    assert list(blueprint.branches) == ["procedure", "procedure_2"]
