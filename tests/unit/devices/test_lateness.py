"""How late messages are, whatever the sender's clock shows."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.lateness import WINDOW, Lateness

delays = st.lists(st.floats(0.0, 5.0), min_size=1, max_size=50)


@given(delays, st.floats(-1e6, 1e6))
def test_lateness_is_the_delay_beyond_the_least_at_any_offset(taken: list[float], offset: float) -> None:
    """The offset is that of the clocks of sender and receiver."""
    lateness, now = Lateness(), 100.0
    for number, delay in enumerate(taken):
        sent = now - delay + offset
        expected = delay - min(taken[: number + 1])
        assert lateness.update(sent, now) == pytest.approx(expected, abs=1e-6)
        assert lateness.delay(sent, now) == pytest.approx(expected, abs=1e-6)
        now += 0.025


def test_with_nothing_to_compare_nothing_is_late() -> None:
    assert Lateness().delay(3.0, 1e9) == 0.0


def test_clocks_that_drift_apart_do_not_make_everything_late() -> None:
    lateness = Lateness()
    worst = max(lateness.update(number * 0.1 * (1 - 2e-4), number * 0.1) for number in range(36_000))
    assert worst < 2.2 * WINDOW * 2e-4


def test_restarted_sender_is_compared_from_its_first_message() -> None:
    lateness = Lateness()
    lateness.update(1000.0, 50.0)
    assert lateness.delay(10.0, 51.0) > 900.0
    lateness.forget()
    assert lateness.update(10.0, 51.0) == 0.0


@given(delays, st.floats(-1e6, 1e6))
def test_sender_time_is_placed_too_late_by_the_least_delay_only(taken: list[float], offset: float) -> None:
    lateness, now = Lateness(), 100.0
    for number, delay in enumerate(taken):
        lateness.update(now - delay + offset, now)
        assert lateness.to_local(42.0 + offset) == pytest.approx(42.0 + min(taken[: number + 1]), abs=1e-6)
        now += 0.025
