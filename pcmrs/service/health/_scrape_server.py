"""HTTP server of the metrics: few connections at a time, each for a short time. Anybody on the machine may connect."""

from __future__ import annotations

import socket
from contextlib import suppress
from socketserver import ThreadingMixIn
from threading import Lock
from typing import Any, Final
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer

import structlog
from prometheus_client import CollectorRegistry, make_wsgi_app

from pcmrs.clock import SystemClock

MOST: Final = 8
"""Limit of open connections. Each needs a thread and a descriptor of the daemon."""
WITHIN: Final = 5.0
"""Limit of the time of a connection, from its beginning until its answer is sent, s."""

log = structlog.get_logger(__name__)


class _Handler(WSGIRequestHandler):
    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing: a scrape every few seconds is no event."""


class ScrapeServer(ThreadingMixIn, WSGIServer):
    """Server that answers scrapes, each in its own thread.

    Args:
        host: Host to bind.
        port: Port to bind; 0 takes any free one.
        registry: The metrics.

    Raises:
        OSError: The port cannot be bound.
    """

    daemon_threads = True

    def __init__(self, host: str, port: int, registry: CollectorRegistry) -> None:
        self._clock = SystemClock()
        self._began: dict[socket.socket, float] = {}
        self._lock = Lock()
        super().__init__((host, port), _Handler)
        self.set_app(make_wsgi_app(registry))

    def verify_request(self, request: Any, client_address: Any) -> bool:  # noqa: ARG002 - of the base class
        """Return False for a connection too many, which is then closed."""
        with self._lock:
            if len(self._began) >= MOST:
                return False
            self._began[request] = self._clock.monotonic()
        return True

    def service_actions(self) -> None:
        """End connections that take too long; called after each connection, and every 0.5 s."""
        with self._lock:
            latest = self._clock.monotonic() - WITHIN
            for request, began in self._began.items():
                if began <= latest:
                    with suppress(OSError):  # the peer has ended it already
                        request.shutdown(socket.SHUT_RDWR)  # its thread reads the end, and closes it

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        with self._lock:
            self._began.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:  # noqa: ARG002 - of the base class
        """Log that a connection was broken, without a traceback: anyone who connects can cause it."""
        log.debug("scrape_failed", client=client_address[0], exc_info=True)
