"""A stream of values from a driver to any number of readers."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Generic, TypeVar

T = TypeVar("T")

BACKLOG = 64
"""Values kept for a slow reader; beyond that it loses the oldest."""


class Stream(Generic[T]):
    """Every reader gets every value published after it began to read, until the stream is closed.

    Attributes:
        dropped: Values that a reader was too slow for.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._readers: set[asyncio.Queue[T | None]] = set()
        self._closed = False

    def publish(self, value: T | None) -> None:
        """Hands `value` to all readers; never blocks."""
        for reader in self._readers:
            if reader.full():
                reader.get_nowait()
                self.dropped += 1
            reader.put_nowait(value)

    def close(self) -> None:
        """Ends all readers once they have read what was published."""
        self._closed = True
        self.publish(None)

    async def read(self) -> AsyncIterator[T]:
        """Yields values as they are published."""
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
