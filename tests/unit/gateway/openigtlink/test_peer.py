"""Messages of a peer become commands once, and their outcomes verdicts and a status."""

from __future__ import annotations

import pytest

from tests.support import openigtlink_bytes as wire
from tests.unit.gateway.igtl_client import planned_mm
from tests.unit.gateway.openigtlink.slicer_room import FACES, LANDMARKS_MM, TARGET, Room


async def test_plan_that_slicer_resends_is_submitted_once(room: Room) -> None:
    data = wire.transform(TARGET, planned_mm()) + wire.points("Landmarks", LANDMARKS_MM, FACES)
    for sent in range(1, 6):
        room.slicer.send(data)
        while room.gateway.counters.received < 2 * sent or len(room.core.commands) < 2:
            await room.slicer.next("CoilToImage")
    room.slicer.send(wire.transform(TARGET, planned_mm((41.0, 60.0, 80.0))))
    while len(room.core.commands) < 3:
        await room.slicer.next("CoilToImage")
    assert room.core.operations == ["plan", "plan_landmarks", "plan"]
    assert room.core.commands[-1].arguments["position"][0] == pytest.approx(0.041)


async def test_rejected_plan_is_shown_until_one_is_accepted(room: Room) -> None:
    room.core.refusals["plan"] = "busy"
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert (await room.slicer.verdict()).startswith("rejected toolplan.plan busy")
    assert (await room.slicer.status(2)).error_name == "busy"
    room.core.refusals.clear()
    room.slicer.send(wire.transform(TARGET, planned_mm((41.0, 60.0, 80.0))))
    assert await room.slicer.verdict() == "accepted toolplan.plan"
    await room.slicer.status(1)


async def test_other_messages_change_nothing_and_are_not_answered(room: Room) -> None:
    for data in (
        wire.string("PcmrsVerdict", "accepted stop"),  # Slicer may send back what it got
        wire.string("S", "move"),
        wire.transform("CoilToImage", planned_mm()),
        wire.points("F", LANDMARKS_MM, FACES),
        wire.message("IMAGE", TARGET, b"x" * 100_000),
        wire.message("GET_STATUS", "", b""),
    ):
        room.slicer.send(data)
    room.slicer.send(wire.string("S", "stop"))
    assert await room.slicer.verdict() == "accepted stop"
    assert room.core.commands == []
    assert room.gateway.counters.refused == 0
