"""No request has a longer body than an upload may have: the browser's own check binds nobody who sends by himself."""

from __future__ import annotations

from pcmrs.console.guard import App, Receive, Scope, Send, answer


class UploadLimit:
    """Stands before the application and refuses a request whose body is too long, or of unknown length, unread.

    The server in front reads no more of a body than its ``content-length`` says.

    Args:
        app: What is behind it.
        largest: Bytes of a body, those that a form adds included.
    """

    def __init__(self, app: App, largest: int) -> None:
        self._app = app
        self._largest = largest

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Lets a request through as long as it is short enough."""
        headers = dict(scope["headers"]) if scope["type"] == "http" else {}
        length = headers.get(b"content-length", b"")
        if b"transfer-encoding" in headers:
            await answer(send, 411, "A request says how long its body is: Content-Length.", {"connection": "close"})
        elif length.isdigit() and int(length) > self._largest:
            await answer(send, 413, f"The limit is {self._largest} bytes.", {"connection": "close"})
        else:
            await self._app(scope, receive, send)
