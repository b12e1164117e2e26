"""A token bucket never lets through more than its burst and its rate, in any order of waits and requests."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.bucket import TokenBucket
from pcmrs.testing.clock import ManualClock

RATE_HZ, BURST = 4.0, 3


@given(st.lists(st.floats(0.0, 2.0)))
def test_no_window_has_more_than_burst_and_rate(pauses: list[float]) -> None:
    clock, taken = ManualClock(), list[float]()
    bucket = TokenBucket(RATE_HZ, BURST, clock)
    for pause in pauses:
        clock.stall(pause)
        if bucket.take():
            taken.append(clock.monotonic())
    for first in range(len(taken)):
        for last in range(first, len(taken)):
            assert last - first + 1 <= BURST + RATE_HZ * (taken[last] - taken[first]) + 1e-6


def test_full_bucket_gives_its_burst_at_once_after_any_wait() -> None:
    clock = ManualClock()
    bucket = TokenBucket(RATE_HZ, BURST, clock)
    clock.stall(1e6)
    assert [bucket.take() for _ in range(BURST + 1)] == [True] * BURST + [False]


@given(st.floats(0.1, 1000.0))
def test_after_the_wait_that_it_names_there_is_a_token(rate_hz: float) -> None:
    clock = ManualClock()
    bucket = TokenBucket(rate_hz, 1, clock)
    assert bucket.wait == 0.0
    assert bucket.take()
    assert not bucket.take()
    assert bucket.wait == pytest.approx(1.0 / rate_hz)
    clock.stall(0.5 * bucket.wait)
    assert not bucket.take()
    clock.stall(1.001 * bucket.wait)
    assert bucket.take()
