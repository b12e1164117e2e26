"""Motion and treatment that steps are known for must be declared: Stop bars only what is declared."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.fsm.rules.declared import KnownHazards, check_declared
from tests.support.altered import with_operation
from tests.unit.fsm.arm_workflow import arm_blueprint

KNOWN = KnownHazards(moving={"move", "follow_head"}, affecting={"fire"})


def test_what_is_declared_has_no_finding() -> None:
    assert list(check_declared(arm_blueprint(), KNOWN)) == []
    assert list(check_declared(arm_blueprint(), KnownHazards())) == []


def test_a_step_that_moves_must_be_declared_as_motion() -> None:
    still = with_operation(arm_blueprint(), "arm", "withdraw", moves=False, motion="none")
    (finding,) = check_declared(still, KNOWN)
    assert (finding.code, finding.path) == ("undeclared", ("branches", "arm", "operations", "withdraw", "steps"))
    assert "arm.withdraw has the step move, which moves the robot: declare `motion`" in finding.text


@pytest.mark.parametrize(
    ("declared", "found"),
    [({}, ["undeclared"]), ({"affects_patient": True}, []), ({"motion": "retreat"}, [])],
)
def test_a_step_that_treats_must_be_declared_unless_it_moves(declared: dict[str, Any], found: list[str]) -> None:
    treating = with_operation(arm_blueprint(), "robot", "connect", steps=["look", "fire"], **declared)
    assert [finding.code for finding in check_declared(treating, KNOWN)] == found


def test_an_activity_that_moves_must_be_declared() -> None:
    (finding,) = check_declared(arm_blueprint(), KnownHazards(moving={"watch_head", "follow_head"}))
    assert finding.path == ("branches", "arm", "activities", "near")
    assert "watch_head of arm near moves the robot" in finding.text
