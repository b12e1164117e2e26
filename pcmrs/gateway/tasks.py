"""Tasks with one owner, so that none outlives the gateway and no failure is silent."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

import structlog

from pcmrs.clock import Clock

T = TypeVar("T")
_log = structlog.get_logger(__name__)


class Tasks:
    """Running tasks; `close` cancels what is left."""

    def __init__(self) -> None:
        self._running: set[asyncio.Task[Any]] = set()

    def spawn(self, work: Coroutine[Any, Any, T]) -> asyncio.Task[T]:
        """Runs `work` as a task of this owner."""
        task = asyncio.get_running_loop().create_task(work)
        self._running.add(task)
        task.add_done_callback(self._ended)
        return task

    async def close(self) -> None:
        """Cancels all tasks and waits for their end."""
        running = list(self._running)
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)

    def _ended(self, task: asyncio.Task[Any]) -> None:
        self._running.discard(task)
        if not task.cancelled() and (error := task.exception()) is not None:
            _log.error("gateway_task_failed", task=repr(task.get_coro()), exc_info=error)


class Repetition:
    """Something done at a steady rate between `start` and `stop`.

    Args:
        clock: Paces it.
        rate_hz: Times per second.
        tick: What is done.
        tasks: Owns it while it runs.
    """

    def __init__(self, clock: Clock, rate_hz: float, tick: Callable[[], None], tasks: Tasks) -> None:
        self._clock = clock
        self._period = 1.0 / rate_hz
        self._tick = tick
        self._tasks = tasks
        self._task: asyncio.Task[None] | None = None

    def start(self) -> None:
        """Begins, unless it runs."""
        if self._task is None or self._task.done():
            self._task = self._tasks.spawn(self._repeat())

    def stop(self) -> None:
        """Ends, if it runs."""
        if self._task is not None:
            self._task.cancel()
            self._task = None

    async def _repeat(self) -> None:
        due = self._clock.monotonic()
        while True:
            self._tick()
            now = self._clock.monotonic()
            due = max(due + self._period, now)  # ticks missed in a stall are not made up for
            await self._clock.sleep(due - now)
