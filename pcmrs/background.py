"""Background tasks that last as long as a context."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager, suppress
from typing import Any


@asynccontextmanager
async def background_task(work: Coroutine[Any, Any, object], name: str | None = None) -> AsyncIterator[None]:
    """Run a coroutine as a task for the length of the context, then cancel it and wait for its end.

    Args:
        work: Coroutine that is not expected to end. If it has failed, leaving the context raises its error.
        name: Name of the task.
    """
    task = asyncio.create_task(work, name=name)
    try:
        yield
    finally:
        task.cancel()
        with suppress(asyncio.CancelledError):
            await task
