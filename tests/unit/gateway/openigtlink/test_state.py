"""The state of all branches as JSON and as one line."""

from __future__ import annotations

import json

from pcmrs.messages import Running
from tests.unit.gateway.openigtlink.slicer_room import Room


async def test_state_is_sent_to_a_new_client_and_at_each_change(room: Room) -> None:
    first = json.loads((await room.slicer.next("PcmrsState")).string)
    assert first["branches"] == room.core.branches
    assert (first["latched"], first["running"]) == (False, [])
    room.core.branches["placement"] = "standoff"
    room.core.running = [Running(branch="placement", operation="approach", id="1")]
    room.core.latched = True
    second = json.loads((await room.slicer.next("PcmrsState")).string)
    assert (second["branches"]["placement"], second["running"]) == ("standoff", ["placement.approach"])
    await room.slicer.next("PcmrsLine")
    line = (await room.slicer.next("PcmrsLine")).string
    assert line.startswith("LATCHED, registration 000")
    assert line.endswith("placement standoff, running placement.approach")
    assert (await room.slicer.status(3)).error_name == "latched"
    room.core.latched = False
    await room.slicer.status(1)
