"""Age and time to live of commands: what is too old, from the future, or no limit at all."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.dispatcher.command_checks import CLOCK_TOLERANCE, check_fresh
from pcmrs.errors import RefusalError
from pcmrs.messages import Command
from tests.support.ratms_oracle import INITIAL
from tests.unit.dispatcher.dispatcher_fakes import Bench


@pytest.mark.parametrize(
    ("ahead", "ttl", "expected_code"),
    [
        (CLOCK_TOLERANCE + 1.0, 1.0, "expired"),
        (CLOCK_TOLERANCE + 1.0, None, "expired"),
        (1e12, 1e13, "expired"),
        (None, 5.0, "bad_arguments"),
        (0.0, -1.0, "bad_arguments"),
        (0.0, float("inf"), "bad_arguments"),
        (0.0, float("nan"), "bad_arguments"),
    ],
)
async def test_command_of_unknown_age_is_rejected_and_changes_nothing(
    bench: Bench, ahead: float | None, ttl: float | None, expected_code: str
) -> None:
    sent = None if ahead is None else bench.clock.wall() + ahead
    verdict = await bench.do("toolplan.plan", id="stamped", sent=sent, ttl=ttl)
    assert (verdict.id, verdict.decision, bench.joint) == ("stamped", "rejected", INITIAL)
    assert verdict.reason is not None
    assert verdict.reason.code == expected_code


@pytest.mark.parametrize("stamp", [{}, {"ahead": 4.0}, {"ahead": 4.0, "ttl": 0.0}, {"ahead": -1e9}])
async def test_sender_clock_may_be_a_bit_ahead_and_no_ttl_is_no_limit(bench: Bench, stamp: dict[str, Any]) -> None:
    sent = bench.clock.wall() + stamp["ahead"] if stamp else None
    assert (await bench.do("toolplan.plan", sent=sent, ttl=stamp.get("ttl"))).decision == "accepted"


class FixedClock:
    """A clock of which only the wall's time is asked."""

    def wall(self) -> float:
        return 1.7e9


@given(age=st.floats(-100.0, 100.0), ttl=st.floats(0.0, 100.0))
def test_command_is_fresh_from_the_tolerance_to_its_time_to_live(age: float, ttl: float) -> None:
    sent = 1.7e9 - age
    command = Command(id="a", branch="robot", operation="connect", source="bus:local", sent=sent, ttl=ttl)
    fresh = -CLOCK_TOLERANCE <= 1.7e9 - sent <= ttl
    with nullcontext() if fresh else pytest.raises(RefusalError, match=r"in the future|limit of"):
        check_fresh(FixedClock(), command)  # type: ignore[arg-type]
