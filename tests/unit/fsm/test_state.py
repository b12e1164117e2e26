"""State objects: active or not, and why they refuse an operation."""

from __future__ import annotations

from pcmrs.fsm import (
    Denial,
    StateSet,
    load_blueprint,
)
from tests.support.ratms_oracle import BLUEPRINT

RATMS = load_blueprint(BLUEPRINT)


def test_a_refusal_names_branch_state_and_operation() -> None:
    denial = StateSet(RATMS).active("registration").ask("register")
    assert isinstance(denial, Denial)
    assert denial.code == "invalid_in_state"
    assert denial.fields == {"branch": "registration", "state": "000", "operation": "register"}
    assert "no landmarks planned" in denial.text
