"""Advice for what was not accepted: what to do, in the words of the workflow."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.messages import Reason, Verdict
from pcmrs.report._advice import DOUBT, MOST_NAMED, advise
from pcmrs.workflows import read_workflow

RATMS = read_workflow("ratms")


def verdict(code: str, decision: Any = "rejected", *, allowed: list[str] | None = None, **fields: Any) -> Verdict:
    return Verdict(
        id="1",
        branch="placement",
        operation="approach",
        decision=decision,
        state="held",
        sequence=1,
        reason=Reason(code=code, text="Refused.", fields=fields),
        allowed=allowed or [],
    )


@pytest.mark.parametrize("code", ["busy", "latched", "not_registered"])
def test_an_unknown_end_is_settled_before_all_else(code: str) -> None:
    assert advise(verdict(code, "unknown"), RATMS) == DOUBT


def test_needed_states_are_named_by_their_meaning() -> None:
    meaning = RATMS.branches["registration"].states["111"]
    refused = verdict("not_registered", branch="registration", needed=["111"])
    assert advise(refused, RATMS) == f"First bring registration to “{meaning}”."
    assert advise(refused, None) == "First bring registration to 111."
    two = verdict("not_registered", branch="registration", needed=["110", "111"])
    assert advise(two, None) == "First bring registration to 110 or 111."


@pytest.mark.parametrize("count", [1, MOST_NAMED, MOST_NAMED + 1])
def test_allowed_operations_are_named_up_to_a_limit(count: int) -> None:
    names = [f"operation_{number}" for number in range(count)]
    advice = advise(verdict("invalid_in_state", allowed=names), RATMS)
    named = ", ".join(names[:MOST_NAMED])
    assert advice == f"Allowed then: {named}{', …' if count > MOST_NAMED else ''}."


def test_without_anything_to_say_the_reason_stands_alone() -> None:
    assert advise(verdict("tre_too_large", tre=0.005), RATMS) == ""
    assert advise(verdict("invalid_in_state"), RATMS) == ""
    assert advise(verdict("not_registered", branch="registration", needed="111"), RATMS) == ""
