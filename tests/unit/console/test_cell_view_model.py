"""What panels know of a cell: ages by its own clock, and not more than the newest events."""

from __future__ import annotations

import pytest

from pcmrs.console._cell_view_model import EPOCHS, EVENTS
from pcmrs.messages import DeviceEvent, Epoch
from tests.unit.console.detached_page import ShownCell


def test_age_counts_from_the_last_message_and_is_none_before() -> None:
    view = ShownCell()
    view.received["coil"], view.now = 10.0, 12.5
    assert view.age("coil") == pytest.approx(2.5)
    assert view.age("joints") is None


def test_only_the_newest_events_and_signals_are_kept() -> None:
    view = ShownCell()
    for number in range(EVENTS + 3):
        view.events.append((float(number), DeviceEvent(device="robot", code="told", text="")))
        view.epochs.append(Epoch(pulse=number, muscle="fdi", rate_hz=5000.0, start=0.0, samples=[]))
    assert [at for at, _ in view.events] == [float(number) for number in range(3, EVENTS + 3)]
    assert [epoch.pulse for epoch in view.epochs] == list(range(EVENTS + 3 - EPOCHS, EVENTS + 3))
