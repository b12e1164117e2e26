"""Differences between journalled and replayed decisions: every part is compared, rounding is none."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.dispatcher.events import NOT_CONFIRMED
from pcmrs.messages import Command, Reason, Verdict
from pcmrs.replay._differences import added, compared, missing, reported_already, same
from pcmrs.replay._keys import command_key, event_key
from pcmrs.replay._recorder import Decided
from tests.unit.replay.rows import event, outcome, stored

plain = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 5) | st.floats(allow_nan=False) | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=2), inner, max_size=3),
    max_leaves=8,
)
LATCHED = Reason(code="latched", text="Stop is latched.")


@given(plain)
def test_data_equals_itself(value: Any) -> None:
    assert same(value, value)


@pytest.mark.parametrize(
    ("before", "now", "equal"),
    [
        (1.0, 1.0 + 1e-12, True),
        (1.0, 1.0 + 1e-6, False),
        (0.0, 1e-13, True),
        (1, 1.0, True),
        ([1.0, 2.0], (1.0, 2.0), True),
        ([1.0, 2.0], [1.0], False),
        ({"a": 1.0}, {"a": 1.0 + 1e-12}, True),
        ({"a": None}, {}, False),
        ("1", 1.0, False),
        (None, 0.0, False),
    ],
)
def test_only_rounding_is_no_difference(before: Any, now: Any, equal: bool) -> None:
    assert same(before, now) == same(now, before) == equal


def decided(
    states: dict[str, str], decision: Any = "accepted", *, reason: Reason | None = None, changes: Any = None
) -> Decided:
    verdict = Verdict(
        id="c1", branch="robot", operation="connect", decision=decision, state="1", sequence=1, reason=reason
    )
    command = Command(id="c1", branch="robot", operation="connect", source="bus:test", arguments={})
    durable: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    return Decided(command_key("outcome", command), states, durable, verdict, changes)


@pytest.mark.parametrize(
    ("again", "what"),
    [
        ({}, []),
        ({"states": {"robot": "0"}}, ["states"]),
        ({"decision": "failed", "reason": LATCHED}, ["decision", "reason"]),
        ({"changes": {"joints": 0.5 + 1e-6}}, ["data.joints"]),
        ({"changes": {"joints": 0.5 + 1e-12}}, []),
        ({"changes": None}, ["data.joints"]),
        ({"changes": {"joints": 0.5, "plan": 1}}, ["data.plan"]),
    ],
)
async def test_each_part_that_differs_is_named(again: dict[str, Any], what: list[str]) -> None:
    states = {"robot": "1"}
    (row,) = stored([outcome("robot.connect", states=states, data={"joints": 0.5})])
    values: dict[str, Any] = {"states": states, "changes": {"joints": 0.5}}
    replayed = decided(**(values | again))
    found = list(compared(row, replayed))
    assert [each.what for each in found] == what
    assert all(each.row == "outcome robot.connect [bus:test]" for each in found)


async def test_rows_of_one_side_are_named_with_decision_and_reason() -> None:
    (row,) = stored([outcome("robot.connect", decision="rejected", reason=LATCHED)])
    lost = missing(row)
    assert (lost.sequence, lost.row, lost.what) == (1, "outcome robot.connect [bus:test]", "row")
    assert (lost.recorded, lost.decided) == ("rejected: latched", None)
    extra = added(7, decided({}, "rejected", reason=LATCHED))
    assert (extra.sequence, extra.row, extra.what) == (7, "outcome robot.connect [bus:test]", "row")
    assert (extra.recorded, extra.decided) == (None, "rejected: latched")


async def test_repeated_report_of_an_unconfirmed_hold_is_none() -> None:
    """Which of several holds was not confirmed no journal tells."""
    durable: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    again = Decided(event_key("robot", NOT_CONFIRMED, danger=True), {}, durable)
    assert reported_already(again, stored([event(NOT_CONFIRMED, danger=True)]))
    assert not reported_already(again, stored([event("stopped", danger=True)]))
    other = Decided(event_key("robot", "stopped", danger=True), {}, durable)
    assert not reported_already(other, stored([event(NOT_CONFIRMED, danger=True)]))
