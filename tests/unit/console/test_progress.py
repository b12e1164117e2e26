"""The remaining time follows from the progress so far."""

from __future__ import annotations

import pytest

from pcmrs.console._progress import EARLIEST, RemainingTime
from pcmrs.messages import Running


def running(progress: float, id: str = "1") -> Running:
    return Running(branch="placement", operation="approach", id=id, progress=progress)


def test_half_of_the_way_takes_as_long_as_the_other_half() -> None:
    now = 100.0
    remaining = RemainingTime(lambda: now)
    assert remaining.of(running(0.0)) is None
    now = 103.0
    assert remaining.of(running(EARLIEST / 2)) is None
    now = 106.0
    assert remaining.of(running(0.5)) == pytest.approx(6.0)


def test_another_operation_starts_again() -> None:
    now = 0.0
    remaining = RemainingTime(lambda: now)
    remaining.of(running(0.0))
    now = 10.0
    assert remaining.of(running(0.4, "2")) is None
    now = 12.0
    assert remaining.of(running(0.6, "2")) == pytest.approx(4.0)
