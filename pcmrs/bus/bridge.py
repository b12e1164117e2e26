"""Hand-over of calls from Zenoh's threads to the event loop, without one wake-up per message.

Calls wait in three places. Two ordered, bounded queues hold what must not be lost silently: events, and commands and
requests; a full queue rejects. For streams, the newest calls of each key are stored. One drain at a time is scheduled
in the loop. It takes events first and streams last, and yields to the loop between slices, so that Stop and timers
never wait behind a backlog. Events have their own queue, because commands must not displace a danger event.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable
from contextvars import ContextVar
from typing import Final

BridgedCall = Callable[[], object]

ARRIVED: Final[ContextVar[float]] = ContextVar("arrived")
"""Arrival time in this process of the message that is handled in this context, s of the machine's monotonic clock."""

CAPACITY: Final = 256
"""Ordered calls that may wait for the loop, in each of the two queues."""

_SLICE: Final = 8
"""Calls that one drain runs before the loop gets a turn."""


class Bridge:
    """Queue of calls from any thread, which run in one event loop.

    Args:
        loop: Event loop that runs the calls.
        capacity: Ordered calls that may wait, in the urgent queue and in the other one.

    Attributes:
        refused: Number of ordered calls that found their queue full.
        replaced: Number of stream calls that were dropped for newer ones of the same key.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, capacity: int = CAPACITY) -> None:
        self._loop = loop
        self._capacity = capacity
        self._urgent: deque[tuple[float, BridgedCall]] = deque()
        self._ordered: deque[tuple[float, BridgedCall]] = deque()
        self._newest: dict[Hashable, deque[BridgedCall]] = {}
        self._lock = threading.Lock()
        self._scheduled = False
        self._closed = False
        self.refused = self.replaced = 0

    @property
    def waiting(self) -> int:
        """Number of calls that wait for the loop."""
        with self._lock:
            return len(self._urgent) + len(self._ordered) + sum(map(len, self._newest.values()))

    def post(self, call: BridgedCall, *, urgent: bool = False) -> bool:
        """Queue a call.

        Args:
            call: Call without arguments.
            urgent: True for an event: it runs before commands and requests.

        Returns:
            False if the queue is full or closed; the call is dropped then.
        """
        queue = self._urgent if urgent else self._ordered
        with self._lock:
            if self._closed or len(queue) >= self._capacity:
                self.refused += 1
                return False
            queue.append((time.monotonic(), call))
            self._schedule()
            return True

    def post_newest(self, key: Hashable, call: BridgedCall, most: int = 1) -> None:
        """Queue a call of a stream; the oldest waiting ones of the same key are dropped.

        Args:
            key: Stream that the call belongs to.
            call: Call without arguments.
            most: Number of calls of this key that may wait.
        """
        with self._lock:
            if not self._closed:
                waiting = self._newest.setdefault(key, deque(maxlen=most))
                self.replaced += len(waiting) == most
                waiting.append(call)
                self._schedule()

    def close(self) -> None:
        """Drop the waiting calls and accept no more."""
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

    def _next(self) -> BridgedCall | None:
        with self._lock:
            for queue in (self._urgent, self._ordered):
                if queue:
                    arrived, call = queue.popleft()
                    ARRIVED.set(arrived)
                    return call
            if self._newest:
                # Round robin: a dict keeps its order of insertion, and a key with more calls goes to the end.
                key = next(iter(self._newest))
                waiting = self._newest.pop(key)
                call = waiting.popleft()
                if waiting:
                    self._newest[key] = waiting
                return call
            self._scheduled = False
            return None
