"""A moved reference is reported until the registration does not rest on it, and not over and over."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from types import SimpleNamespace
from typing import Any, cast

import pytest

from pcmrs.messages import DeviceEvent
from pcmrs.service.watches import reference
from pcmrs.service.watches.reference import PERIOD, ReferenceWatch
from pcmrs.testing.clock import ManualClock, settle
from pcmrs.workflows.reference import ReferenceShift

SHIFT = ReferenceShift(translation=0.004, rotation=0.02)


class Room:
    """A registered patient whose reference moves when the test says so, and a workflow that changes likewise."""

    def __init__(self) -> None:
        self.clock = ManualClock()
        self.shift: ReferenceShift | None = None
        self.states = {"registration": "111", "drilling": "off"}
        self.events: list[DeviceEvent] = []
        self.procedure = SimpleNamespace(data=None, joint=lambda: dict(self.states))

    async def report(self, event: DeviceEvent) -> None:
        self.events.append(event)

    async def look(self, times: int = 3) -> int:
        """Return the number of reports after so many checks."""
        await self.clock.advance(times * PERIOD)
        return len(self.events)


@pytest.fixture
async def room(monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Room]:
    made = Room()
    monkeypatch.setattr(reference, "detected_shift", lambda cell, data: made.shift)
    monkeypatch.setattr(reference, "shift_text", lambda shift, cell: f"It moved by {shift.translation * 1e3:g} mm.")
    watching = asyncio.create_task(ReferenceWatch(cast(Any, made), cast(Any, made)).run())
    await settle()
    yield made
    watching.cancel()
    await asyncio.gather(watching, return_exceptions=True)


async def test_a_shift_is_one_danger_with_its_size(room: Room) -> None:
    assert await room.look() == 0
    room.shift = SHIFT
    assert await room.look() == 1
    (event,) = room.events
    assert (event.device, event.code, event.danger) == ("tracker", "reference_moved", True)
    assert event.fields == {"translation": 0.004, "rotation": 0.02}
    assert event.text == "It moved by 4 mm."


async def test_shift_that_was_refused_is_reported_after_any_change(room: Room) -> None:
    """With a drill in the bone the workflow refuses it; afterwards the registration must not count again."""
    room.shift = SHIFT
    room.states["drilling"] = "on"
    assert await room.look() == 1
    room.states["drilling"] = "off"
    assert await room.look() == 2
    room.states["registration"] = "100"
    assert await room.look() == 2, "nothing rests on it any more"


async def test_reference_that_moves_once_more_is_reported_again(room: Room) -> None:
    for number in range(1, 4):
        room.shift = SHIFT
        assert await room.look() == number
        room.shift = None
        assert await room.look() == number


@pytest.mark.parametrize("state", ["000", "100"])
async def test_without_a_registration_a_shift_is_no_danger(room: Room, state: str) -> None:
    room.states["registration"] = state
    room.shift = SHIFT
    assert await room.look() == 0
