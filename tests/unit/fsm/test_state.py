"""State objects: active or not, and why they refuse an operation."""

from __future__ import annotations

import pytest

from pcmrs.fsm import (
    Denial,
    StateSet,
)
from pcmrs.fsm._state import Answer, State
from pcmrs.fsm.blueprint import OperationSpec
from tests.support.shipped import shipped_blueprint

RATMS = shipped_blueprint("ratms")


def test_a_refusal_names_branch_state_and_operation() -> None:
    denial = StateSet(RATMS).active("registration").ask("register")
    assert isinstance(denial, Denial)
    assert denial.code == "invalid_in_state"
    assert denial.fields == {"branch": "registration", "state": "000", "operation": "register"}
    assert "no landmarks planned" in denial.text


DOOR_OPENS = OperationSpec(from_=["shut"], to="open")


class Door(State):
    """A branch: refuses all of its operations."""

    branch = "door"

    def unlock(self) -> Answer:
        return self.refuse("unlock")


class Shut(Door):
    """A state: overrides what is valid in it."""

    name = "shut"
    meaning = "locked"

    def unlock(self) -> Answer:
        return DOOR_OPENS


class Open(Door):
    """A state in which nothing is valid."""

    name = "open"
    meaning = "anybody may pass"


def test_a_state_answers_itself_or_as_its_branch_refuses() -> None:
    assert Shut().ask("unlock") is DOOR_OPENS
    assert Open().ask("unlock") == Denial(
        "invalid_in_state",
        "door is in open (anybody may pass), which does not allow unlock.",
        {"branch": "door", "state": "open", "operation": "unlock"},
    )
    with pytest.raises(AttributeError):
        Open().ask("burn")


def test_only_the_object_that_is_activated_is_active() -> None:
    here, elsewhere = Shut(), Shut()
    here.activate()
    assert (here.active, elsewhere.active) == (True, False)
    here.deactivate()
    assert not here.active
