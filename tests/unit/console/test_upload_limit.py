"""The server itself bounds what it takes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import uvicorn

from pcmrs.console.uploads import UploadLimit

LIMIT = 1000


async def post(*headers: str, body: bytes) -> tuple[int, list[bytes]]:
    """Status, and what the application was given, of a request to the server that the console uses."""
    given: list[bytes] = []

    async def application(scope: Any, receive: Any, send: Any) -> None:
        message = {"more_body": True}
        while message.get("more_body"):
            message = await receive()
            given.append(message["body"])
        await send({"type": "http.response.start", "status": 200})
        await send({"type": "http.response.body", "body": b""})

    async with serving(UploadLimit(application, LIMIT)) as port:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        head = "\r\n".join(("POST / HTTP/1.1", "Host: here", "Connection: close", *headers))
        writer.write(head.encode() + b"\r\n\r\n" + body)
        status = int((await reader.readline()).split()[1])
        writer.close()
    return status, given


@asynccontextmanager
async def serving(application: Any) -> AsyncIterator[int]:
    """The port at which it is served."""
    server = uvicorn.Server(uvicorn.Config(application, port=0, lifespan="off", log_level="critical"))
    server.config.load()
    server.lifespan = server.config.lifespan_class(server.config)
    await server.startup()
    try:
        yield server.servers[0].sockets[0].getsockname()[1]
    finally:
        await server.shutdown()


async def test_upload_within_the_limit_is_taken() -> None:
    status, given = await post(f"Content-Length: {LIMIT}", body=bytes(LIMIT))
    assert (status, b"".join(given)) == (200, bytes(LIMIT))


async def test_upload_declared_too_long_is_refused_unread() -> None:
    assert await post(f"Content-Length: {LIMIT + 1}", body=bytes(LIMIT + 1)) == (413, [])


async def test_upload_without_a_length_is_refused_unread() -> None:
    pieces = b"".join(b"%x\r\n%b\r\n" % (length, bytes(length)) for length in (600, 500)) + b"0\r\n\r\n"
    assert await post("Transfer-Encoding: chunked", body=pieces) == (411, [])
    assert await post("Content-Length: 10", "Transfer-Encoding: chunked", body=pieces) in ((411, []), (400, []))


async def test_upload_is_cut_at_its_declared_length() -> None:
    _, given = await post("Content-Length: 10", body=bytes(2 * LIMIT))
    assert b"".join(given) == bytes(10)
