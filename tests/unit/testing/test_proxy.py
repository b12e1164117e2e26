"""Proxies spoil a link as they say, and only so."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from pcmrs.testing.impairment import NetworkImpairment
from pcmrs.testing.proxy import tcp_proxy, udp_proxy


class _Echo(asyncio.DatagramProtocol):
    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport: Any = transport

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        self._transport.sendto(data, addr)


class _Client(asyncio.DatagramProtocol):
    def __init__(self) -> None:
        self.received: asyncio.Queue[bytes] = asyncio.Queue()

    def datagram_received(self, data: bytes, _: tuple[Any, ...]) -> None:
        self.received.put_nowait(data)


async def _echoes(weather: NetworkImpairment, sent: int, expected: int) -> list[bytes]:
    """What comes back of numbered datagrams, until as many have come as are expected."""
    loop = asyncio.get_running_loop()
    server, _ = await loop.create_datagram_endpoint(_Echo, local_addr=("127.0.0.1", 0))
    async with udp_proxy(server.get_extra_info("sockname")[:2], weather) as address:
        transport, client = await loop.create_datagram_endpoint(_Client, remote_addr=address)
        for number in range(sent):
            transport.sendto(b"%d" % number)
        async with asyncio.timeout(10.0):
            received = [await client.received.get() for _ in range(expected)]
        transport.close()
    server.close()
    return received


async def test_in_fair_weather_everything_comes_back_in_order() -> None:
    assert await _echoes(NetworkImpairment(), 50, 50) == [b"%d" % number for number in range(50)]


async def test_message_doubled_both_ways_arrives_four_times() -> None:
    received = await _echoes(NetworkImpairment(doubled=1.0), 5, 20)
    assert sorted(received) == sorted([b"%d" % number for number in range(5)] * 4)


async def test_datagrams_overtake_each_other() -> None:
    weather = NetworkImpairment(seed=1, jitter=0.1)
    received = await _echoes(weather, 40, 40)
    assert sorted(received) == sorted(b"%d" % number for number in range(40))
    assert weather.counted["overtaken"] > 0
    assert received != sorted(received, key=int)


@pytest.fixture
async def echoing() -> Any:
    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(1000):
            writer.write(data)
        writer.close()

    server = await asyncio.start_server(echo, "127.0.0.1", 0)
    yield server.sockets[0].getsockname()[:2]
    server.close()


@pytest.mark.parametrize("cut", ["towards", "back"])
async def test_a_cut_direction_stalls_and_loses_nothing(echoing: tuple[str, int], cut: str) -> None:
    weather = NetworkImpairment()
    async with tcp_proxy(echoing, weather) as address:
        reader, writer = await asyncio.open_connection(*address)
        writer.write(b"before")
        assert await reader.readexactly(6) == b"before"
        setattr(weather, cut, False)
        writer.write(b"during")
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.2):
                await reader.readexactly(1)
        assert weather.passed[cut] == len(b"before")
        setattr(weather, cut, True)
        async with asyncio.timeout(10.0):
            assert await reader.readexactly(6) == b"during"
        assert weather.passed == {"towards": 12, "back": 12}
        writer.close()
        await writer.wait_closed()


async def test_a_server_that_is_not_there_closes_the_connection() -> None:
    async with tcp_proxy(("127.0.0.1", 9), NetworkImpairment()) as address:
        reader, writer = await asyncio.open_connection(*address)
        async with asyncio.timeout(10.0):
            assert await reader.read() == b""
        writer.close()
        await writer.wait_closed()
