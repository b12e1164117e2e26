"""Plans of a peer are decided one after the other, and Stop passes them."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from pcmrs.messages import Command, Verdict
from tests.support import openigtlink_bytes as wire
from tests.unit.gateway.gateway_fakes import WITHIN, UdpClient
from tests.unit.gateway.igtl_client import planned_mm
from tests.unit.gateway.openigtlink.slicer_room import FACES, LANDMARKS_MM, TARGET, Room


async def test_while_a_plan_is_decided_only_the_newest_waits(room: Room) -> None:
    room.core.gates["plan"].clear()
    room.slicer.send(wire.transform(TARGET, planned_mm((9.0, 60.0, 80.0))))
    async with asyncio.timeout(WITHIN):
        await room.core.arrived.wait()
    for x in range(30):
        room.slicer.send(wire.transform(TARGET, planned_mm((10.0 + x, 60.0, 80.0))))
    room.slicer.send(wire.points("Landmarks", LANDMARKS_MM, FACES))
    while room.gateway.counters.received < 32:
        await room.slicer.next("CoilToImage")
    room.core.gates["plan"].set()
    assert [await room.slicer.verdict() for _ in range(3)] == [
        "accepted toolplan.plan",
        "accepted toolplan.plan",
        "accepted registration.plan_landmarks",
    ]
    first, newest, _ = room.core.commands
    assert first.arguments["position"][0] == pytest.approx(0.009)
    assert newest.arguments["position"][0] == pytest.approx(0.039)


@pytest.mark.parametrize("by_daemon", [True, False])
async def test_a_refused_plan_holds_the_motions_of_its_host_back(room: Room, by_daemon: bool) -> None:
    panel, robot = await UdpClient.open(), room.gateway.addresses["robot"]
    assert (await panel.ask("execute_motionxx_#1;", robot)).startswith("1_accepted")
    if by_daemon:
        room.core.refusals["plan"] = "unreachable"
    room.slicer.send(wire.transform(TARGET, planned_mm((41.0, 60.0, 80.0)) if by_daemon else np.eye(4)))
    assert (await room.slicer.verdict()).startswith("rejected")
    room.core.refusals.clear()
    assert (await panel.ask("execute_motionxx_#2;", robot)).endswith("plan_not_accepted;")
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert (await room.slicer.verdict()).startswith("accepted")
    assert (await panel.ask("execute_motionxx_#3;", robot)).startswith("3_accepted")
    panel.transport.close()


async def test_stop_passes_a_plan_under_way_and_rejects_what_waits(room: Room) -> None:
    room.core.gates["plan"].clear()
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    async with asyncio.timeout(WITHIN):
        await room.core.arrived.wait()
    room.slicer.send(wire.points("Landmarks", LANDMARKS_MM, FACES) + wire.string("Anything", " Stop\n"))
    assert (await room.slicer.verdict()).startswith("rejected registration.plan_landmarks stopped")
    assert await room.slicer.verdict() == "accepted stop"
    assert len(room.core.stops) == 1
    room.core.gates["plan"].set()
    assert await room.slicer.verdict() == "accepted toolplan.plan"  # the one under way is the daemon's to end
    room.slicer.send(wire.transform(TARGET, planned_mm((41.0, 60.0, 80.0))))
    assert await room.slicer.verdict() == "accepted toolplan.plan"
    assert room.core.operations == ["plan", "plan"]


async def test_a_stop_that_is_not_confirmed_is_no_success(room: Room) -> None:
    room.core.stands = False
    room.slicer.send(wire.string("S", "stop"))
    assert (await room.slicer.verdict()).startswith("failed stop hold_not_confirmed")


async def test_a_daemon_that_breaks_is_answered_for(room: Room, monkeypatch: pytest.MonkeyPatch) -> None:
    async def broken(command: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(room.core, "submit", broken)
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert (await room.slicer.verdict()).startswith("failed toolplan.plan internal_error")


async def test_plan_that_is_not_accepted_without_a_reason_is_answered(
    room: Room, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def undecided(command: Command) -> Verdict:
        return Verdict(id=command.id, branch="toolplan", operation="plan", decision="unknown", state="0", sequence=1)

    monkeypatch.setattr(room.core, "submit", undecided)
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert (await room.slicer.verdict()).startswith("unknown toolplan.plan unknown")
    assert (await room.slicer.status(2)).error_name == "unknown"
