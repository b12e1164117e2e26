"""Connections to the page without a request: limited in number, time and size."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
import uvicorn
from uvicorn.server import ServerState

from pcmrs.console import _connections as connections
from pcmrs.console._connections import LONGEST_HEAD, MOST_SILENT, LimitedProtocol, limited_protocol
from pcmrs.console.guard import Receive, Scope, Send, answer

WITHIN = 20.0
"""Longest wait of a test for one event, s."""
REQUEST = b"GET / HTTP/1.1\r\nHost: here\r\n\r\n"


async def page(_: Scope, __: Receive, send: Send) -> None:
    await answer(send, 200, "the page", {"content-length": "8"})


@asynccontextmanager
async def served() -> AsyncIterator[tuple[int, type[LimitedProtocol]]]:
    """Port of a server, and its protocol."""
    protocol = limited_protocol()
    config = uvicorn.Config(page, http=protocol, log_level="warning", lifespan="off", access_log=False)
    config.load()
    state, loop = ServerState(), asyncio.get_running_loop()
    server = await loop.create_server(
        lambda: protocol(config=config, server_state=state, app_state={}), "127.0.0.1", 0, backlog=4 * MOST_SILENT
    )
    async with server:
        yield server.sockets[0].getsockname()[1], protocol


Connection = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def asked(connection: Connection) -> bytes:
    """Body of the answer to a request."""
    reader, writer = connection
    writer.write(REQUEST)
    async with asyncio.timeout(WITHIN):
        await reader.readuntil(b"\r\n\r\n")
        return await reader.readexactly(8)


async def has_ended(connection: Connection) -> bool:
    async with asyncio.timeout(WITHIN):
        try:
            return await connection[0].read() == b""
        except ConnectionResetError:
            return True


async def test_silent_connections_keep_no_browser_out() -> None:
    async with served() as (port, protocol):
        opened = [await asyncio.open_connection("127.0.0.1", port) for _ in range(MOST_SILENT + 3)]
        assert [await has_ended(each) for each in opened[:3]] == [True] * 3
        assert len(protocol.silent) == MOST_SILENT
        browser = await asyncio.open_connection("127.0.0.1", port)
        assert await asked(browser) == b"the page"
        assert len(protocol.silent) == MOST_SILENT - 1, "one has made place, and the browser is not silent"
        for _, writer in (*opened, browser):
            writer.close()


async def test_a_connection_ends_if_no_request_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    async with served() as (port, protocol):
        browser = await asyncio.open_connection("127.0.0.1", port)
        assert await asked(browser) == b"the page"
        monkeypatch.setattr(connections, "FIRST_WITHIN", 0.0)
        silent = await asyncio.open_connection("127.0.0.1", port)
        assert await has_ended(silent)
        assert len(protocol.silent) == 0
        assert await asked(browser) == b"the page", "who has asked once may ask again"
        for _, writer in (silent, browser):
            writer.close()


async def test_headers_without_an_end_fill_no_memory() -> None:
    async with served() as (port, protocol):
        endless = await asyncio.open_connection("127.0.0.1", port)
        endless[1].write(REQUEST[:-2] + b"X-Long: " + b"x" * LONGEST_HEAD)
        assert await has_ended(endless)
        assert len(protocol.silent) == 0
        endless[1].close()
