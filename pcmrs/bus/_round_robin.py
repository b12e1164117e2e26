"""Round-robin scheduling of requests that only read: a few at a time, in turn over their keys.

So one client with many requests can neither fill the event loop nor keep the others waiting.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from typing import Final

from pcmrs.bus._fair_queue import FairQueue

AT_ONCE: Final = 4
"""Number of requests that are served at the same time."""
WAITING: Final = 64
"""Number of requests on one key that may wait; one more is refused. A key that names a user counts for that user."""
KEYS: Final = 256
"""Number of keys on which requests may wait; on one more key they are refused."""

Start = Callable[[], asyncio.Task[None]]
"""Starts to serve a request and returns its task."""


class RoundRobin:
    """Scheduler that starts requests in the event loop, those of all keys in turn.

    Args:
        loop: Event loop that serves the requests.

    Attributes:
        refused: Number of requests that were refused.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._lock = threading.Lock()
        self._waiting: FairQueue[Start] = FairQueue(WAITING, KEYS)
        self._running = 0
        self._closed = False
        self.refused = 0

    @property
    def waiting(self) -> int:
        """Number of requests that wait for their turn."""
        with self._lock:
            return len(self._waiting)

    def post(self, key: str, start: Start) -> bool:
        """Queue a request, from any thread.

        Args:
            key: Absolute key of the request.
            start: Called in the event loop when it is the request's turn.

        Returns:
            False if too many requests wait; this one is dropped then.
        """
        with self._lock:
            was_empty = not self._waiting
            if self._closed or not self._waiting.put(key, start):
                self.refused += 1
                return False
            if was_empty:
                self._loop.call_soon_threadsafe(self._serve)
            return True

    def close(self) -> None:
        """Drop the waiting requests and accept no more."""
        with self._lock:
            self._closed = True
            self._waiting.clear()

    def _serve(self) -> None:
        while self._running < AT_ONCE and (start := self._next()) is not None:
            self._running += 1
            start().add_done_callback(self._end)

    def _end(self, _: asyncio.Task[None]) -> None:
        self._running -= 1
        self._serve()

    def _next(self) -> Start | None:
        with self._lock:
            return self._waiting.take()
