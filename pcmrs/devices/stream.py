"""A stream of values from a driver to any number of readers."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Generic, TypeVar

__all__ = ["Stream"]

T = TypeVar("T")

BACKLOG = 64
"""Number of values that wait for a slow reader; beyond that it loses the oldest."""


class Stream(Generic[T]):
    """Channel that gives every reader the values that are published after it began to read, until the stream is closed.

    Attributes:
        dropped: Number of values that were lost because a reader was too slow.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._readers: set[asyncio.Queue[T | None]] = set()
        self._closed = False

    def publish(self, value: T | None) -> None:
        """Deliver `value` to all readers; never blocks. None ends them."""
        for reader in self._readers:
            if reader.full():
                reader.get_nowait()
                self.dropped += 1
            reader.put_nowait(value)

    def close(self) -> None:
        """End all readers once they have read what was published."""
        self._closed = True
        self.publish(None)

    async def read(self) -> AsyncIterator[T]:
        """Yield values as they are published."""
        reader: asyncio.Queue[T | None] = asyncio.Queue(BACKLOG)
        self._readers.add(reader)
        try:
            while not self._closed or not reader.empty():
                value = await reader.get()
                if value is None:
                    return
                yield value
        finally:
            self._readers.discard(reader)
