"""Tasks that run while something else is done, each with an owner, so that none is lost and no failure is silent."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from typing import Any, TypeVar

from pcmrs.clock import Clock

T = TypeVar("T")

FailurePolicy = Callable[[asyncio.Task[Any], BaseException], object]
"""Called with a task that has failed, and its error."""


def report_to_loop(task: asyncio.Task[Any], error: BaseException) -> None:
    """Hand the error of a task to the exception handler of its event loop.

    Args:
        task: The task that has failed.
        error: Its error.
    """
    context = {"message": f"{task.get_coro()!r} has failed", "exception": error, "task": task}
    task.get_loop().call_exception_handler(context)


def logged_as(event: str) -> FailurePolicy:
    """Return a policy that logs the error of a task as `event`."""

    def log_failure(task: asyncio.Task[Any], error: BaseException) -> None:
        import structlog  # a client has background tasks, too, and loads as little as possible

        structlog.get_logger(__name__).error(event, task=repr(task.get_coro()), exc_info=error)

    return log_failure


class BackgroundTasks:
    """Owner of tasks until they end.

    A task that must be restarted when it fails belongs to the `Supervisor` of the daemon instead.

    Args:
        on_failure: Failure policy. It is not called for tasks that are cancelled.
    """

    def __init__(self, on_failure: FailurePolicy = report_to_loop) -> None:
        self._on_failure = on_failure
        self._running: set[asyncio.Task[Any]] = set()

    def __len__(self) -> int:
        return len(self._running)

    def spawn(self, work: Coroutine[Any, Any, T]) -> asyncio.Task[T]:
        """Run `work` as a task of this owner, and return the task."""
        task = asyncio.get_running_loop().create_task(work)
        self._running.add(task)
        task.add_done_callback(self._end)
        return task

    async def wait(self) -> None:
        """Wait until all tasks have ended, including those that are spawned meanwhile."""
        while self._running:
            await asyncio.wait(self._running)

    async def finish(self, clock: Clock, seconds: float) -> None:
        """Wait until the tasks that run now have ended, for a limited time.

        Args:
            clock: Clock of the limit.
            seconds: Limit, s of `clock`.
        """
        if self._running:
            with suppress(TimeoutError):
                async with clock.timeout(seconds):
                    await asyncio.wait(self._running)

    async def close(self) -> None:
        """Cancel all tasks and wait for their end."""
        running = list(self._running)
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)

    def _end(self, task: asyncio.Task[Any]) -> None:
        self._running.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            self._on_failure(task, error)


@asynccontextmanager
async def background_task(work: Coroutine[Any, Any, object], name: str | None = None) -> AsyncIterator[None]:
    """Run `work` as a task for the length of the context, then cancel it and wait for its end.

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
