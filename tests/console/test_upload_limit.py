"""The server itself bounds what it takes."""

from __future__ import annotations

from collections.abc import MutableMapping
from typing import Any

import pytest

from pcmrs.console.upload_limit import UploadLimit

LIMIT = 1000


async def post(pieces: list[bytes], length: int | None) -> tuple[int | None, list[str]]:
    """Status, and what the application was given, of a request of these pieces."""
    given: list[str] = []
    statuses: list[int] = []
    waiting = [{"type": "http.request", "body": piece, "more_body": True} for piece in pieces]
    waiting.append({"type": "http.request", "body": b"", "more_body": False})

    async def receive() -> MutableMapping[str, Any]:
        return waiting.pop(0)

    async def send(message: MutableMapping[str, Any]) -> None:
        if message["type"] == "http.response.start":
            statuses.append(message["status"])

    async def application(scope: Any, receive: Any, send: Any) -> None:
        message = {"more_body": True}
        while message.get("more_body"):
            message = await receive()
            given.append(message["type"])
        await send({"type": "http.response.start", "status": 200})

    headers = [] if length is None else [(b"content-length", str(length).encode())]
    await UploadLimit(application, LIMIT)({"type": "http", "headers": headers}, receive, send)
    return statuses[0] if statuses else None, given


async def test_what_fits_is_taken() -> None:
    status, given = await post([bytes(600), bytes(400)], LIMIT)
    assert (status, given) == (200, ["http.request"] * 3)


async def test_what_says_that_it_is_longer_is_refused_unread() -> None:
    assert await post([bytes(600), bytes(401)], LIMIT + 1) == (413, [])


@pytest.mark.parametrize("length", [None, 10])
async def test_what_is_longer_than_it_says_ends_at_the_limit(length: int | None) -> None:
    """In pieces without a length; a server takes no more than a length says, but that is its matter."""
    _, given = await post([bytes(600), bytes(400), bytes(1), bytes(600)], length)
    assert given == ["http.request", "http.request", "http.disconnect"]
