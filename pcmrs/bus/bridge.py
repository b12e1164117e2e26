"""From Zenoh's threads into the event loop, without one wake-up per message.

Calls wait in three places: two ordered, bounded queues for what must not be lost in silence (events; commands and
requests: a full queue rejects), and the newest calls of each key for streams. One drain at a time is scheduled in the
loop; it takes events first, streams last, and gives the loop a turn between slices, so that Stop and timers are never
behind a backlog. Events have a queue of their own, since one of danger must not be turned away because of commands.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable
from contextvars import ContextVar
from typing import Final

Call = Callable[[], object]

ARRIVED: Final[ContextVar[float]] = ContextVar("arrived")
"""When the message that is handled here arrived in this process, s of the machine's monotonic clock."""

CAPACITY: Final = 256
"""Ordered calls that may wait for the loop, in each of the two queues."""

_SLICE: Final = 8


class Bridge:
    """Runs calls from any thread in one event loop.

    Args:
        loop: Where the calls run.
        capacity: Ordered calls that may wait, urgent ones and others.

    Attributes:
        refused: Ordered calls that found the queue full.
        replaced: Calls of streams that were dropped for newer ones of the same key.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, capacity: int = CAPACITY) -> None:
        self._loop = loop
        self._capacity = capacity
        self._urgent: deque[tuple[float, Call]] = deque()
        self._ordered: deque[tuple[float, Call]] = deque()
        self._newest: dict[Hashable, deque[Call]] = {}
        self._lock = threading.Lock()
        self._scheduled = False
        self._closed = False
        self.refused = self.replaced = 0

    @property
    def waiting(self) -> int:
        """Calls that wait for the loop."""
        with self._lock:
            return len(self._urgent) + len(self._ordered) + sum(map(len, self._newest.values()))

    def post(self, call: Call, *, urgent: bool = False) -> bool:
        """Queues a call; returns False, and forgets it, when its queue is full or closed."""
        queue = self._urgent if urgent else self._ordered
        with self._lock:
            if self._closed or len(queue) >= self._capacity:
                self.refused += 1
                return False
            queue.append((time.monotonic(), call))
            self._schedule()
            return True

    def post_newest(self, key: Hashable, call: Call, most: int = 1) -> None:
        """Queues a call; of those of the same key that have not run yet, `most` are kept, the newest."""
        with self._lock:
            if not self._closed:
                waiting = self._newest.setdefault(key, deque(maxlen=most))
                self.replaced += len(waiting) == most
                waiting.append(call)
                self._schedule()

    def close(self) -> None:
        """Forgets what waits and takes nothing more."""
        with self._lock:
            self._closed = True
            self._urgent.clear()
            self._ordered.clear()
            self._newest.clear()

    def _schedule(self) -> None:
        if not self._scheduled:
            self._scheduled = True
            self._loop.call_soon_threadsafe(self._drain)

    def _drain(self) -> None:
        for _ in range(_SLICE):
            call = self._next()
            if call is None:
                return
            try:
                call()
            except Exception as error:
                self._loop.call_exception_handler({"message": "A bus handler failed", "exception": error})
        self._loop.call_soon(self._drain)

    def _next(self) -> Call | None:
        with self._lock:
            for queue in (self._urgent, self._ordered):
                if queue:
                    arrived, call = queue.popleft()
                    ARRIVED.set(arrived)
                    return call
            if self._newest:
                # A dict keeps the order in which keys came, and one with more goes to its end: every key gets its turn.
                key = next(iter(self._newest))
                waiting = self._newest.pop(key)
                call = waiting.popleft()
                if waiting:
                    self._newest[key] = waiting
                return call
            self._scheduled = False
            return None
