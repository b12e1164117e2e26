"""Requests that only read are served a few at a time, and those who ask take turns: nobody fills the loop with them."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from typing import Final

AT_ONCE: Final = 4
"""Requests that are served at the same time."""
WAITING: Final = 64
"""Requests on one key that wait; one more is refused. Where a key names a user, that is for each user."""
KEYS: Final = 256
"""Keys on which requests wait; on one more they are refused."""

Start = Callable[[], asyncio.Task[None]]


class Turns:
    """Starts requests in the event loop, those of all keys in turn.

    Args:
        loop: Where they are served.

    Attributes:
        refused: Requests that found no place.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._lock = threading.Lock()
        self._waiting: dict[str, deque[Start]] = {}
        self._running = 0
        self._closed = False
        self.refused = 0

    @property
    def waiting(self) -> int:
        """Requests that wait for their turn."""
        with self._lock:
            return sum(map(len, self._waiting.values()))

    def post(self, key: str, start: Start) -> bool:
        """Queues a request, from any thread; returns False, and forgets it, when its key has too many waiting."""
        with self._lock:
            full = key not in self._waiting and len(self._waiting) >= KEYS
            if self._closed or full or len(self._waiting.get(key, ())) >= WAITING:
                self.refused += 1
                return False
            if not self._waiting:
                self._loop.call_soon_threadsafe(self._serve)
            self._waiting.setdefault(key, deque()).append(start)
            return True

    def close(self) -> None:
        """Forgets what waits and takes nothing more."""
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
            if not self._waiting:
                return None
            key = next(iter(self._waiting))
            waiting = self._waiting.pop(key)
            start = waiting.popleft()
            if waiting:
                self._waiting[key] = waiting  # at the end: the other keys come first
            return start
