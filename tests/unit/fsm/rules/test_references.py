"""References to branches, states and operations that do not exist, each reported where it is."""

from __future__ import annotations

import pytest

from tests.unit.fsm.needle_workflow import PLAIN, found
from tests.unit.fsm.rules.small_workflow import Fault, check_fault

FAULTS: dict[str, Fault] = {
    "parent missing": ('branch = "top"', 'branch = "roof"', "unknown_branch", "roof", "parent"),
    "parent is itself": ('branch = "top"', 'branch = "sub"', "unknown_state", "sub", "parent"),
    "compatible with nothing": ('"1" = ["11"] }', '"1" = ["12"] }', "unknown_state", "'12'", "compatible"),
    "start unknown": ('start = "10"', 'start = "99"', "unknown_state", "'99'", "start"),
    "from unknown": ('from = ["safe"]', 'from = ["far"]', "unknown_state", "'far'", "from"),
    "to unknown": ('to = "near"\nmotion', 'to = "far"\nmotion', "unknown_state", "'far'", "to ="),
    "failure unknown": ('on_failure = "held"', 'on_failure = "far"', "unknown_state", "'far'", "on_failure"),
    "requires unknown branch": ('{ top = ["11"] }', '{ tip = ["11"] }', "unknown_branch", "'tip'", "requires"),
    "requires unknown state": ('{ top = ["11"] }', '{ top = ["77"] }', "unknown_state", "'77'", "requires"),
    "revoked by nobody": ('by = ["top"]', 'by = ["tip"]', "unknown_branch", "'tip'", "revocations"),
    "revoked to nowhere": (
        'from = ["near"], to = "safe"',
        'from = ["near"], to = "far"',
        "unknown_state",
        "'far'",
        "to",
    ),
    "diverted to nowhere": (
        '[branches.top.operations.prepare]\nfrom = ["*"]\nto = "10"',
        '[branches.top.operations.prepare]\nfrom = ["*"]\n'
        'outcomes = { all = { to = "10", revoked_to = { side = "far" } } }',
        "unknown_state",
        "'far'",
        "revoked_to",
    ),
    "goal unknown": ('version = "1"', 'version = "1"\ngoal = { top = ["12"] }', "unknown_state", "'12'", "goal"),
    "property of no state": (
        'version = "1"',
        'version = "1"\n[[properties]]\nid = "p"\nnever = { states = { top = [] } }',
        "unknown_state",
        "can never hold",
        "never",
    ),
    "property of no operation": (
        'version = "1"',
        'version = "1"\n[[properties]]\nid = "p"\nalways = { running = ["side.fly"] }',
        "unknown_operation",
        "'side.fly'",
        "always",
    ),
    "rule 2, no such operation": ('"1" = "reached"', '"1" = "arrived"', "unknown_operation", "arrived", "emits"),
    "rule 2, state unknown": (
        '"1" = "reached" }',
        '"1" = "reached", "2" = "lost" }',
        "unknown_state",
        "'2'",
        "emits",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_named_where_it_is(fault: str) -> None:
    check_fault(FAULTS[fault])


def test_operation_to_allow_again_must_exist() -> None:
    assert found(PLAIN.replace('["sample"]', '["stitch"]')) == [("unknown_operation", None)]
