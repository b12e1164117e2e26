"""Connections of the OpenIGTLink link: damaged, many, from elsewhere."""

from __future__ import annotations

import asyncio
import socket
import struct
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import uvloop

from pcmrs.clock import SystemClock
from pcmrs.errors import ConfigurationError
from pcmrs.gateway.links import open_gateway
from pcmrs.gateway.openigtlink.link import MOST, MOST_OF_A_HOST
from pcmrs.gateway.settings import OpenIgtLinkConfig
from tests.support import openigtlink_bytes as wire
from tests.unit.gateway.gateway_fakes import WITHIN
from tests.unit.gateway.igtl_client import Slicer, SlicerCore, planned_mm, slicer_only
from tests.unit.gateway.openigtlink.slicer_room import TARGET, Room, opened

Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def test_a_header_of_version_2_is_taken_too(room: Room) -> None:
    data = wire.with_metadata("TRANSFORM", TARGET, wire.matrix_bytes(planned_mm()), {"TransformStatus": "OK"})
    room.slicer.send(data)
    assert await room.slicer.verdict() == "accepted toolplan.plan"


async def test_a_damaged_message_is_counted_and_changes_nothing(room: Room) -> None:
    damaged = bytearray(wire.transform(TARGET, planned_mm()))
    damaged[-1] ^= 1
    room.slicer.send(bytes(damaged) + wire.transform(TARGET, planned_mm((50.0, 0.0, 0.0))))
    assert await room.slicer.verdict() == "accepted toolplan.plan"
    assert room.gateway.counters.refused == 1
    assert len(room.core.commands) == 1


async def test_data_that_is_no_openigtlink_ends_only_its_connection(room: Room) -> None:
    stranger = await Slicer.connect(room.address)
    stranger.send(b"GET / HTTP/1.1\r\n" + b"x" * 100)
    with pytest.raises((asyncio.IncompleteReadError, ConnectionError)):
        await stranger.next("nothing")
    stranger.close()
    assert room.gateway.counters.refused == 1
    room.slicer.send(wire.transform(TARGET, planned_mm()))
    assert await room.slicer.verdict() == "accepted toolplan.plan"


async def test_client_may_leave_in_mid_message_and_come_back(room: Room) -> None:
    room.slicer.send(wire.transform(TARGET, planned_mm())[:70])
    room.slicer.close()
    again = await Slicer.connect(room.address)
    again.send(wire.transform(TARGET, planned_mm()))
    assert await again.verdict() == "accepted toolplan.plan"
    assert len(room.core.commands) == 1
    again.close()


async def connected(room: Room, *hosts: str) -> list[Connection]:
    """Connections from these addresses, opened at once."""
    opening = (asyncio.open_connection(*room.address, local_addr=(host, 0)) for host in hosts)
    return list(await asyncio.gather(*opening))


async def served_of(connections: list[Connection]) -> int:
    """Return how many of the connections are served; close all."""
    served = 0
    for reader, writer in connections:
        with suppress(ConnectionResetError):
            async with asyncio.timeout(WITHIN):
                served += bool(await reader.read(1))
        writer.close()
    return served


async def test_a_burst_of_clients_finds_no_more_places(room: Room) -> None:
    """They are accepted before the first of them is served."""
    await room.slicer.next("PcmrsState")
    assert await served_of(await connected(room, *["127.0.0.1"] * 20)) == MOST_OF_A_HOST - 1
    assert room.gateway.counters.refused == 20 - (MOST_OF_A_HOST - 1)


async def test_one_address_leaves_places_to_others(room: Room) -> None:
    await room.slicer.next("PcmrsState")
    hosts = [f"127.0.0.{2 + number % 3}" for number in range(30)]
    assert await served_of(await connected(room, *hosts)) == MOST - 1
    async with asyncio.timeout(WITHIN):
        while await served_of(await connected(room, "127.0.0.2")) == 0:
            pass  # the link notices the closed connections one after the other


def test_connection_reset_before_it_is_taken_disturbs_nobody(tmp_path: Path) -> None:
    """In uvloop, in which the daemon runs, it has no address any more."""

    async def serve() -> None:
        troubles: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, trouble: troubles.append(trouble))
        links = slicer_only(OpenIgtLinkConfig(enabled=True, port=0))
        async with open_gateway(SlicerCore(), links, SystemClock(), tmp_path) as gateway:
            for _ in range(MOST_OF_A_HOST - 1):
                with socket.create_connection(gateway.addresses["openigtlink"]) as gone:
                    gone.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            slicer = await Slicer.connect(gateway.addresses["openigtlink"])
            await slicer.next("PcmrsState")
            slicer.close()
        assert troubles == []

    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        runner.run(serve())


async def test_link_off_loopback_shows_but_takes_no_commands(tmp_path: Path) -> None:
    core = SlicerCore()
    exposed = slicer_only(OpenIgtLinkConfig(enabled=True, port=0), host="0.0.0.0")
    async with open_gateway(core, exposed, SystemClock(), tmp_path) as gateway:
        slicer = await Slicer.connect(("127.0.0.1", gateway.addresses["openigtlink"][1]))
        slicer.send(wire.transform(TARGET, planned_mm()) + wire.string("S", "stop"))
        async with asyncio.timeout(WITHIN):
            await slicer.next("CoilToImage")
            while gateway.counters.refused < 2:
                await slicer.next("CoilToImage")
        slicer.close()
    assert (core.commands, core.stops) == ([], [])


async def test_port_in_use_is_an_error(room: Room, tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"OpenIGTLink port .* cannot be bound"):
        async with opened(tmp_path, port=room.address[1]):
            pass


async def test_it_is_off_unless_asked_for(tmp_path: Path) -> None:
    off = slicer_only(OpenIgtLinkConfig())
    async with open_gateway(SlicerCore(), off, SystemClock(), tmp_path) as gateway:
        assert gateway.addresses == {}
