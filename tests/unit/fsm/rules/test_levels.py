"""Rules 1 to 3 between a branch and the branch that it refines: each violation is reported where it is."""

from __future__ import annotations

import pytest

from tests.unit.fsm.rules.small_workflow import Fault, check_fault

FAULTS: dict[str, Fault] = {
    "rule 1, no rio": ("rio = true", "", "rule_1", "sub", "[branches.sub]"),
    "rule 1, two": (
        "[branches.side]",
        "[branches.sub.operations.again]\nfrom = ['*']\nto = '0'\nrio = true\n[branches.side]",
        "rule_1",
        "again",
        "again",
    ),
    "rule 1, one state without": ('from = ["*"]\nto = "0"', 'from = ["0"]\nto = "0"', "rule_1", "in 1", "from"),
    "rule 1, not to the start": ('to = "0"\nrio', 'to = "1"\nrio', "rule_1", "the start 0", "reinit"),
    "rule 2, silent": (', "1" = "reached" }', " }", "rule_2", "to 1", "emits"),
    "rule 2, not incoming": ('"1" = "reached"', '"1" = "prepare"', "rule_2", "prepare", "emits"),
    "rule 3, start does not fit": ('"0" = ["00", "10"]', '"0" = ["00"]', "rule_3", "top 10", "compatible"),
    "rule 3, first state": ('"0" = ["00", "10"]', '"0" = ["10"]', "rule_3", "top 00", "compatible"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_where_it_is(fault: str) -> None:
    check_fault(FAULTS[fault])
