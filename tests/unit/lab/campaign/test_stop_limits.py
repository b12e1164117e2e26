"""Limits of Stop during a flood: of the 99th percentile and of the maximum, each beyond that of a bare timer."""

from __future__ import annotations

import pytest

from pcmrs_lab.campaign.stop_limits import exceeded


@pytest.mark.parametrize(
    ("usual", "worst", "timer", "wrong"),
    [
        (0.010, 0.010, 0.0, []),
        (0.010, 0.099, 0.0, []),
        (0.010, 0.101, 0.0, ["max 101.0 ms, limit 100 ms and the bare timer's lateness of 0.0 ms."]),
        (0.051, 0.051, 0.0, ["p99 51.0 ms, limit 50 ms and the bare timer's lateness of 0.0 ms."]),
        (0.130, 0.130, 0.0, ["p99", "max"]),
        (0.051, 0.130, 0.031, []),
    ],
)
def test_both_limits_are_checked_beside_a_timer(usual: float, worst: float, timer: float, wrong: list[str]) -> None:
    taken = [usual] * 99 + [worst]
    found = list(exceeded(taken, [timer] * 10))
    assert len(found) == len(wrong)
    assert all(text.startswith(start) for text, start in zip(found, wrong, strict=True))
