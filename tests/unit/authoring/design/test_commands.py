"""Operations that the steps of a branch ask for: by name and kind, each at its place in the table."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.authoring.design._commands import MAKE_SAFE, check_operations, operations_of
from tests.unit.authoring.design.step_tables import converted, step


def asked(*steps: dict[str, Any]) -> list[tuple[str, str, str]]:
    (group,), paths = converted(*steps)
    return [(each.name, each.kind, ".".join(each.path)) for each in operations_of(group, paths)]


def test_a_step_is_achieved_in_several_ways_and_taken_back() -> None:
    alternatives = [{"operation": "load_a"}, {"operation": "try_a", "partial": True}]
    assert asked(step("a", alternatives=alternatives, reopened_by=["clear"])) == [
        ("do_a", "achieve", "steps.0.operation"),
        ("load_a", "achieve", "steps.0.alternatives.0"),
        ("try_a", "partial", "steps.0.alternatives.1"),
        ("clear", "reopen", "steps.0.reopened_by.0"),
    ]


def test_a_refined_step_is_only_signalled() -> None:
    inner = {"branch": "inside", "steps": [step("p")]}
    assert asked(step("a", refined_by=inner)) == [
        ("do_a", "signal", "steps.0.operation"),
        ("undo_a", "unsignal", "steps.0.operation"),
    ]


def test_people_report_safety_and_allow_what_cannot_be_undone() -> None:
    (group,), paths = converted(step("a"), step("b", "a", moves=True, irreversible=True))
    found = {each.name: each for each in operations_of(group, paths)}
    assert list(found) == ["do_a", "do_b", MAKE_SAFE, "allow_do_b_again"]
    assert [found[name].action.roles for name in (MAKE_SAFE, "allow_do_b_again")] == [["operator"], ["operator"]]
    assert (found["do_b"].hazard.moves, found["do_b"].hazard.irreversible) == (True, True)
    assert not found[MAKE_SAFE].hazard.counts


@pytest.mark.parametrize(
    ("steps", "collisions"),
    [
        ([step("a", reopened_by=["clear"]), step("b", "a", reopened_by=["clear"])], []),
        ([step("a", reopened_by=["clear"]), step("b", "a", reopened_by=["clear"], roles=["operator"])], ["clear"]),
        ([step("a", reopened_by=["do_b"]), step("b", "a")], ["do_b"]),
        ([step("a", operation="reinit")], ["reinit"]),
    ],
)
def test_only_equal_ways_back_may_share_a_name(steps: list[dict[str, Any]], collisions: list[str]) -> None:
    (group,), paths = converted(*steps)
    commands = list(operations_of(group, paths))
    findings = list(check_operations(group, commands))
    assert [finding.code for finding in findings] == ["name_collision"] * len(collisions)
    assert all(f"two different operations {name!r}" in f.text for name, f in zip(collisions, findings, strict=True))
