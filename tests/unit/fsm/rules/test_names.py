"""Names that a blueprint cannot use, each reported where it is."""

from __future__ import annotations

import pytest

from pcmrs.fsm import examine
from tests.unit.fsm.rules.small_workflow import Fault, check_fault

FAULTS: dict[str, Fault] = {
    "workflow name": ('id = "small"', 'id = "Small one"', "bad_name", "'Small one'", 'id = "Small one"'),
    "version": ('version = "1"', 'version = ""', "bad_name", "version", "version"),
    "branch name": ("branches.side", "branches.Side", "bad_name", "'Side'", "[branches.Side]"),
    "bus syntax": ("operations.clear]", "operations.'a/*']", "bad_name", "'a/*'", "a/*"),
    "keyword": ("operations.clear]", "operations.pass]", "reserved_name", "'pass'", "operations.pass"),
    "reserved operation": ("operations.clear]", "operations.active]", "reserved_name", "'active'", "active"),
    "reserved outcome": (
        'to = "near"\nmotion',
        'outcomes = { failed = { to = "near" } }\nmotion',
        "reserved_name",
        "'failed'",
        "outcomes",
    ),
    "one class for two": ("[branches.side]", "[branches.to_p]\n[branches.side]", "no_states", "to_p", "to_p"),
    "no states": (
        'states = { safe = "clear", near = "close", held = "stopped" }',
        "states = {}",
        "no_states",
        "side",
        "[branches.side]",
    ),
    "state name": ("near =", '"so near" =', "bad_name", "'so near'", "so near"),
    "digit for each flag": ('"ready", "finished"]', '"ready"]', "bad_flags", "state 00", '"00"'),
    "a flag twice": ('"ready", "finished"]', '"ready", "ready"]', "name_collision", "flag ready", "flags"),
    "property without a name": (
        'version = "1"',
        'version = "1"\n[[properties]]\nid = ""\nnever = { states = { top = ["10"] } }',
        "bad_name",
        "a property",
        "id =",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_where_it_is(fault: str) -> None:
    check_fault(FAULTS[fault])


def test_two_branches_of_one_class_are_refused() -> None:
    text = 'id = "x"\nversion = "1"\n' + "".join(
        f'[branches.{name}]\nstates = {{ a = "" }}\n' for name in ("tool_1", "tool1")
    )
    findings = examine(text.encode()).findings
    assert [(finding.code, finding.line) for finding in findings] == [("name_collision", 5)]
