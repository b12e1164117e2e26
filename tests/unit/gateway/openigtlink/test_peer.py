"""Messages of a peer become commands once, their outcomes a verdict and a status; a slow peer delays nobody."""

from __future__ import annotations

import asyncio
import socket
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from pcmrs.clock import SystemClock
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.openigtlink import _peer, link
from pcmrs.gateway.openigtlink._peer import MAX_WAITING, Outbox
from pcmrs.gateway.settings import OpenIgtLinkConfig
from tests.support import openigtlink_bytes as wire
from tests.unit.gateway.gateway_fakes import WITHIN
from tests.unit.gateway.igtl_client import Slicer, SlicerCore, planned_mm, slicer_only
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


class Receiver:
    """Takes the place of a connection whose other side reads when the test says so."""

    def __init__(self) -> None:
        self.sent: asyncio.Queue[bytes] = asyncio.Queue()
        self.reads = asyncio.Event()
        self.transport = self

    def set_write_buffer_limits(self, high: int) -> None:
        assert high == 0

    def write(self, data: bytes) -> None:
        self.sent.put_nowait(data)

    async def drain(self) -> None:
        await self.reads.wait()


async def test_of_each_pose_the_newest_waits_and_of_all_else_so_many() -> None:
    box, receiver = Outbox(), Receiver()
    sending = asyncio.create_task(box.send(receiver, SystemClock()))  # type: ignore[arg-type]
    box.put(b"first,")
    assert await receiver.sent.get() == b"first,"
    for number in range(MAX_WAITING + 3):
        box.put(b"%d," % number)
        box.put_pose("A", b"A%d," % number)
        box.put_pose("B", b"B%d," % number)
    assert box.dropped == 3 + 2 * (MAX_WAITING + 2)
    receiver.reads.set()
    expected = [b"%d" % number for number in range(3, MAX_WAITING + 3)]
    assert await receiver.sent.get() == b",".join([*expected, b"A102", b"B102", b""])
    sending.cancel()
    await asyncio.gather(sending, return_exceptions=True)


async def test_client_that_does_not_read_delays_nobody_and_is_cut_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_peer, "STALLED_AFTER", 0.2)
    monkeypatch.setattr(link, "SEND_BUFFER", 4096)
    core = SlicerCore()
    config = slicer_only(OpenIgtLinkConfig(enabled=True, port=0, rate_hz=500.0))
    with capture_logs() as logs:
        async with open_gateway(core, config, SystemClock(), tmp_path) as gateway:
            idle = socket.socket()
            idle.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            idle.connect(gateway.addresses["openigtlink"])
            reading = await Slicer.connect(gateway.addresses["openigtlink"])
            async with asyncio.timeout(WITHIN):
                while not (stalled := [each for each in logs if each["event"] == "openigtlink_stalled"]):
                    # The one that reads is served all the while.
                    await reading.next("CoilToImage")
            reading.send(wire.transform("ToolTargetToImage", planned_mm()))
            assert await reading.verdict() == "accepted toolplan.plan"
            reading.close()
            idle.close()
    assert stalled[0]["dropped"] > 0
