"""Tasks with one owner, so that none outlives the gateway and no failure is silent."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import suppress
from typing import Any, TypeVar

import structlog

from pcmrs.clock import Clock
from pcmrs.gateway.periodic_timer import Beats

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

    async def finish(self, clock: Clock, seconds: float) -> None:
        """Waits until the tasks that run now have ended, at most `seconds` of `clock`."""
        if self._running:
            with suppress(TimeoutError):
                async with clock.timeout(seconds):
                    await asyncio.wait(self._running)

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


class PeriodicTask:
    """Something done at a steady rate between `start` and `stop`, whatever the network says to it.

    Args:
        beats: Pace it.
        rate_hz: Times per second.
        tick: What is done.
        tasks: Owns it while it runs.
    """

    def __init__(self, beats: Beats, rate_hz: float, tick: Callable[[], None], tasks: Tasks) -> None:
        self._beats = beats
        self._period = 1.0 / rate_hz
        self._tick = tick
        self._tasks = tasks
        self._task: asyncio.Task[None] | None = None
        self._failing = False

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
        async for _ in self._beats(self._period):
            self._try()

    def _try(self) -> None:
        """One tick; only the first of several that fail in a row is logged."""
        try:
            self._tick()
        except OSError as error:
            if not self._failing:
                _log.warning("not_sent", tick=self._tick.__qualname__, reason=str(error))
            self._failing = True
        else:
            self._failing = False
