"""A press of unknown age is late, whatever the browser reports."""

from __future__ import annotations

from typing import Any

import pytest

from pcmrs.console._press import BEAT_PERIOD, LATE, Press, beat_of


def test_a_press_is_late_once_its_beat_is_old() -> None:
    press = Press.of({"meaning": "approach", "beat": beat_of(100.0)})
    assert press.meaning == "approach"
    assert not press.is_late(100.0 + BEAT_PERIOD)
    assert not press.is_late(100.0 + LATE - 0.01)
    assert press.is_late(100.0 + LATE + 0.01)


@pytest.mark.parametrize(
    "reported", [None, [], "1", {}, {"beat": ""}, {"beat": "nan"}, {"beat": "inf"}, {"beat": 99.0}]
)
def test_a_press_without_a_true_beat_is_late(reported: Any) -> None:
    assert Press.of(reported).is_late(1.0)
