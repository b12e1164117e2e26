"""No request has a longer body than an upload may have: the browser's own check binds nobody who sends by himself."""

from __future__ import annotations

from collections.abc import MutableMapping
from typing import Any

from pcmrs.console.guard import App, Receive, Scope, Send, answer


class UploadLimit:
    """Stands before the application and ends a request at the byte that is too much.

    Args:
        app: What is behind it.
        largest: Bytes of a body, those that a form adds included.
    """

    def __init__(self, app: App, largest: int) -> None:
        self._app = app
        self._largest = largest

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Lets a request through as long as it is short enough."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        length = dict(scope["headers"]).get(b"content-length", b"")
        if length.isdigit() and int(length) > self._largest:
            await answer(send, 413, f"The limit is {self._largest} bytes.", {"connection": "close"})
            return
        taken = 0

        async def counted() -> MutableMapping[str, Any]:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            # What comes without a length, in pieces, is told apart only here; the application then gives up.
            return message if taken <= self._largest else {"type": "http.disconnect"}

        await self._app(scope, counted, send)
