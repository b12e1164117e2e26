"""Limits of connections without a request: they never block the page, which has a button for Stop."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import ClassVar, Final

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

MOST_SILENT: Final = 64
"""Limit of connections on which no request has arrived. A browser sends its request at once, and needs few of them."""
FIRST_WITHIN: Final = 10.0
"""Limit of the time until the first request has arrived, s."""
LONGEST_HEAD: Final = 2**16
"""Limit of the first line and the headers of the first request, bytes."""


@dataclass(slots=True)
class _Silent:
    """A connection on which no request has arrived yet: the timer that ends it, and the bytes that have arrived."""

    timer: asyncio.TimerHandle
    received: int = 0


class SilentConnections:
    """Connections on which no request has arrived yet, the oldest first.

    If there are too many, the oldest ends. So a flood of them cannot block a browser, which sends its request at once.
    """

    def __init__(self) -> None:
        self._open: dict[asyncio.BaseTransport, _Silent] = {}

    def __len__(self) -> int:
        return len(self._open)

    def add(self, transport: asyncio.Transport) -> None:
        """Add a new connection; end the oldest if there are too many, and this one if no request arrives in time."""
        if len(self._open) >= MOST_SILENT:
            self._end(next(iter(self._open)))
        timer = asyncio.get_running_loop().call_later(FIRST_WITHIN, self._end, transport)
        self._open[transport] = _Silent(timer)

    def receive(self, transport: asyncio.Transport, count: int) -> None:
        """Count the bytes of a request that has not arrived as a whole; end the connection if they are too many.

        Args:
            transport: The connection; one on which a request has arrived is ignored.
            count: Number of bytes.
        """
        silent = self._open.get(transport)
        if silent is not None:
            silent.received += count
            if silent.received > LONGEST_HEAD:
                self._end(transport)

    def remove(self, transport: asyncio.BaseTransport) -> None:
        """Remove a connection on which a request has arrived, or that has ended."""
        silent = self._open.pop(transport, None)
        if silent is not None:
            silent.timer.cancel()

    def _end(self, transport: asyncio.BaseTransport) -> None:
        self.remove(transport)
        transport.close()


class LimitedProtocol(HttpToolsProtocol):
    """HTTP of one connection, within the limits of `silent`.

    Attributes:
        silent: Connections of the server that have not sent a request.
    """

    silent: ClassVar[SilentConnections]

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See `asyncio.BaseProtocol.connection_made`."""
        super().connection_made(transport)
        self.silent.add(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """See `asyncio.BaseProtocol.connection_lost`."""
        self.silent.remove(self.transport)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """See `asyncio.Protocol.data_received`."""
        super().data_received(data)
        self.silent.receive(self.transport, len(data))

    def on_headers_complete(self) -> None:
        """Count the connection as one with a request: its parser calls this after the headers."""
        self.silent.remove(self.transport)
        super().on_headers_complete()


def limited_protocol() -> type[LimitedProtocol]:
    """Return the protocol of a new server, with its own connections."""

    class ServerProtocol(LimitedProtocol):
        silent = SilentConnections()

    return ServerProtocol
