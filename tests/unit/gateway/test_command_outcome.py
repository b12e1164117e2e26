"""Outcomes and the replies that report them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.gateway._command_outcome import NO_DATA, CommandOutcome, of_verdict
from pcmrs.gateway.commands import Second
from pcmrs.messages import Verdict
from pcmrs.planner import parse_reply


@given(
    st.sampled_from(["rejected", "failed"]),
    st.from_regex(r"[0-9]{1,10}", fullmatch=True),
    st.from_regex(r"[a-z]+(_[a-z]+)*", fullmatch=True),
)
def test_a_refusal_stays_parseable_whatever_its_reason(decision: str, client_id: str, reason: str) -> None:
    outcome = CommandOutcome(decision, "tool_plan", "in_air", reason)  # type: ignore[arg-type]
    back_id, verdict = parse_reply(outcome.reply(client_id).encode())
    assert (back_id, verdict.decision, verdict.branch, verdict.state, verdict.reason) == (
        client_id, decision, "tool-plan", "in-air", reason,
    )  # fmt: skip


@given(st.lists(st.floats(-1e3, 1e3), max_size=9))
def test_results_follow_an_acceptance(numbers: list[float]) -> None:
    _, verdict = parse_reply(
        CommandOutcome("accepted", "placement", "placed", numbers=tuple(numbers)).reply("1").encode()
    )
    assert verdict.results == pytest.approx(numbers, rel=1e-5)


def test_a_refused_registration_never_shows_numbers() -> None:
    for refused in ("rejected", "failed"):
        outcome = CommandOutcome(refused, "registration", "110", "residual_too_large", (2.3,))
        assert outcome.second(Second.RESIDUAL) == NO_DATA
    assert CommandOutcome("accepted", "registration", "111", numbers=(2.300912,)).second(Second.RESIDUAL) == "2.300912"


def test_unknown_outcome_is_reported_as_unknown() -> None:
    unknown = Verdict(
        id="1", branch="placement", operation="approach", decision="unknown", state="unknown", sequence=1,
        result={"residual": 0.001},
    )  # fmt: skip
    assert of_verdict(unknown).reply("7") == "7_failed_placement_unknown_outcome_unknown;"
