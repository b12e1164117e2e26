"""Branches that a table need not name: the connection of the robot, and the release of Stop."""

from __future__ import annotations

import pytest

from pcmrs.authoring.design._safety import lost
from pcmrs.fsm import Denial, Engine
from tests.unit.authoring.design.biopsy_cell import WAY_IN, biopsy_cell, is_accepted, perform


@pytest.fixture
def cell() -> Engine:
    return biopsy_cell()


def test_robot_lost_at_the_patient_must_first_be_made_safe(cell: Engine) -> None:
    perform(cell, *WAY_IN, "robot.link_lost", "robot.connect")
    assert not is_accepted(cell, "procedure.align")
    assert not is_accepted(cell, "robot.connect")
    perform(cell, "procedure.make_safe", "procedure.align")


def test_the_robot_is_not_disconnected_at_the_patient(cell: Engine) -> None:
    perform(cell, *WAY_IN)
    answer = cell.ask("robot", "disconnect")
    assert isinstance(answer, Denial)
    assert answer.code == "tool_near_patient"


def test_states_with_one_end_after_a_loss_share_a_revocation() -> None:
    ends = {"110": "101", "100": "001", "111": "101"}
    rules = lost(ends)
    assert [(rule.by, rule.from_, rule.to) for rule in rules] == [
        (["robot"], ["110", "111"], "101"),
        (["robot"], ["100"], "001"),
    ]
    assert lost({}) == []
