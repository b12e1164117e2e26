"""A row of the journal that is queued already, and awaited later."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Generator
from typing import Any

from pcmrs.errors import JournalError


class QueuedRow:
    """Awaiting it returns when the row is durable, or `failed` has been called.

    Args:
        queue: Queues the row, as the methods of `Recorder` do.
        failed: Called with the `JournalError` when it could not be queued or written.
    """

    def __init__(self, queue: Callable[[], Awaitable[None]], failed: Callable[[JournalError], object]) -> None:
        self._failed = failed
        self._row: Awaitable[None] | JournalError
        try:
            self._row = queue()
        except JournalError as error:
            self._row = error

    def __await__(self) -> Generator[Any, None, None]:
        return self.durable().__await__()

    async def durable(self) -> None:
        """Returns when the row is durable, or `failed` has been called."""
        try:
            if isinstance(self._row, JournalError):
                raise self._row
            await self._row
        except JournalError as error:
            self._failed(error)
