"""The guard of the force on the tool: it reports an excess once, and each further one."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.motion.force import HYSTERESIS, ForceGuard, ForceSettings

forces = st.lists(st.floats(0.0, 60.0), max_size=40)


def test_excess_is_reported_once_so_the_arm_can_move_away() -> None:
    guard = ForceGuard(20.0)
    assert [guard.exceeded(force) for force in (20.0, 20.1, 20.1, 24.0, 16.0, 21.0)] == [False, True] + 4 * [False]


def test_a_force_that_grows_further_or_comes_again_is_reported() -> None:
    guard = ForceGuard(20.0)
    reported = [force for force in (21.0, 26.0, 26.1, 31.0, 31.2, 20.0, 14.9, 20.5) if guard.exceeded(force)]
    assert reported == [21.0, 26.1, 31.2, 20.5]


def test_a_small_limit_is_armed_again_at_half_of_it() -> None:
    """A fall by the whole hysteresis could never come."""
    guard = ForceGuard(4.0)
    assert [guard.exceeded(force) for force in (4.5, 2.1, 4.5, 1.9, 4.5)] == [True, False, False, False, True]


@given(st.floats(0.5, 40.0), forces)
def test_no_report_below_the_limit_and_none_is_missed_at_rest(limit: float, course: list[float]) -> None:
    guard, greatest = ForceGuard(limit), -1.0
    for force in course:
        if force < max(limit - HYSTERESIS, limit / 2.0):
            greatest = -1.0
        expected = force > limit and (greatest < 0.0 or force > greatest + HYSTERESIS)
        assert guard.exceeded(force) == expected
        if expected:
            greatest = force


@pytest.mark.parametrize(
    ("key", "value"),
    [("force_limit", 0.0), ("relief_mm", -0.1), ("relief_mm", 5.1), ("deadman", 0.04), ("deadman", 1.1)],
)
def test_limits_that_protect_nobody_are_refused(key: str, value: Any) -> None:
    with pytest.raises(msgspec.ValidationError, match=key):
        msgspec.convert({key: value}, ForceSettings)


def test_limit_counts_once_and_again_only_if_the_force_grows() -> None:
    guard = ForceGuard(25.0)
    course = [10.0, 25.5, 26.0, 24.0, 26.0, 25.4 + HYSTERESIS, 25.6 + HYSTERESIS, 25.0 - HYSTERESIS - 0.1, 25.1]
    assert [guard.exceeded(force) for force in course] == [False, True, False, False, False, False, True, False, True]


@pytest.mark.parametrize("limit", [1.0, 3.0, 5.0, 6.0, 25.0])
def test_limit_of_any_size_counts_again_after_the_force_fell(limit: float) -> None:
    guard = ForceGuard(limit)
    fallen = max(limit - HYSTERESIS, limit / 2)
    course = [1.01 * limit, 1.01 * fallen, 1.01 * limit, 0.99 * fallen, limit, 1.01 * limit]
    assert [guard.exceeded(force) for force in course] == [True, False, False, False, False, True]
