"""A flood of connections opens one after the other, and its result is complete at the end."""

from __future__ import annotations

import asyncio

import pytest

from pcmrs.errors import DeviceError
from pcmrs_lab.campaign.connection_flood import ConnectionFlood, connection_flood
from pcmrs_lab.campaign.sham import sham
from tests.unit.lab.campaign.scripted_child import ScriptedChild, started


@pytest.mark.parametrize("tls", [False, True])
async def test_connections_are_opened_until_the_end(tls: bool) -> None:
    """With TLS each begins a handshake, whose first byte says so."""
    first: asyncio.Queue[bytes] = asyncio.Queue()

    async def take(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        first.put_nowait(await reader.read(1))
        writer.close()

    server = await asyncio.start_server(take, "127.0.0.1", 0)
    async with server, connection_flood(server.sockets[0].getsockname()[:2], tls=tls) as flooding:
        bytes_seen = [await first.get() for _ in range(3)]
    assert set(bytes_seen) == ({b"\x16"} if tls else {b""})
    assert flooding.connections >= 3
    assert flooding.rate > 0.0


async def test_a_flood_that_does_not_start_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    started(monkeypatch, ScriptedChild(b""))
    with pytest.raises(DeviceError, match="did not start"):
        async with connection_flood(("127.0.0.1", 1)):
            pass


async def test_a_sham_flood_opens_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    started(monkeypatch)
    with sham():
        async with connection_flood(("127.0.0.1", 1)) as flooding:
            pass
    assert flooding == ConnectionFlood()
    assert flooding.rate == 0.0
