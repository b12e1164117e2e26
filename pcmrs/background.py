"""Work that goes on while something else is done."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager, suppress
from typing import Any


@asynccontextmanager
async def background_task(work: Coroutine[Any, Any, object], name: str | None = None) -> AsyncIterator[None]:
    """Runs `work` as a task for the length of the context, then cancels it and waits for its end.

    Args:
        work: Is not expected to end; if it has failed, leaving raises its error.
        name: Of the task.
    """
    task = asyncio.create_task(work, name=name)
    try:
        yield
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
