"""Browser half of the console's page without a browser: it loads the page and presses its Stop."""

from __future__ import annotations

import asyncio
import html
import json
import re
import uuid
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any
from urllib.parse import urlencode, urlsplit

import aiohttp
import socketio  # type: ignore[import-untyped]

ELEMENTS = re.compile(r"parseElements\(String\.raw`(.*?)`\)", re.DOTALL)
CLIENT, MESSAGE = re.compile(r"'client_id': '([0-9a-f-]+)'"), re.compile(r"'next_message_id': (\d+)")
LOADED, PERIOD = 120.0, 0.5
"""Time within which the page shows a Stop, s, and period of the attempts: the console must reach the daemon first."""

Button = tuple[int, str]
"""Number of an element, and id of its click listener."""


class Page:
    """Loaded page; use `open_page`."""

    def __init__(self, socket: socketio.AsyncClient, client: str, stop: Button) -> None:
        self._socket, self._client, self._stop = socket, client, stop

    async def stop(self) -> None:
        """Send the message of a click on the page's Stop."""
        number, listener = self._stop
        await self._socket.emit(
            "event", {"id": number, "client_id": self._client, "listener_id": listener, "args": ["{}"]}
        )


@asynccontextmanager
async def open_page(url: str) -> AsyncIterator[Page]:
    """Load the page at an address with its token, and stay connected for the length of the context."""
    parts = urlsplit(url)
    origin = f"{parts.scheme}://{parts.netloc}"
    async with aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as http:
        text, stop = await _load(http, url)
        client = _found(CLIENT, text)
        query = {
            "client_id": client,
            "next_message_id": _found(MESSAGE, text),
            "implicit_handshake": "true",
            "tab_id": str(uuid.uuid4()),
            "document_id": str(uuid.uuid4()),
        }
        socket = socketio.AsyncClient(http_session=http, reconnection=False)
        await socket.connect(
            f"{origin}?{urlencode(query)}",
            headers={"Origin": origin},
            transports=["websocket"],
            socketio_path="/_nicegui_ws/socket.io",
        )
        try:
            yield Page(socket, client, stop)
        finally:
            await socket.disconnect()


async def _load(http: aiohttp.ClientSession, url: str) -> tuple[str, Button]:
    """Return the text of the page, and its Stop."""
    async with asyncio.timeout(LOADED):
        while True:
            async with http.get(url) as answer:
                answer.raise_for_status()
                text = await answer.text()
            elements: dict[str, Any] = json.loads(html.unescape(_found(ELEMENTS, text)))
            for number, each in elements.items():
                if each.get("props", {}).get("data-testid") == "stop":
                    return text, (int(number), each["events"][0]["listener_id"])
            await asyncio.sleep(PERIOD)


def _found(pattern: re.Pattern[str], text: str) -> str:
    match = pattern.search(text)
    if match is None:
        raise ValueError(f"The page has no {pattern.pattern}: NiceGUI may have changed.")
    return match[1]
