"""Holds the robot, for Stop and after a motion that has not ended well."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import structlog

from pcmrs.dispatcher.tasks import Tasks

log = structlog.get_logger(__name__)


class Hold:
    """Asks the devices to stand still, and says whether that was confirmed.

    Those who stop while the hold of a Stop is under way wait for that one: nothing can begin to move in between, since
    the latch is set and cannot be released before. The hold of a motion is never merged with another one, for the
    request of that motion may still be on its way: only a hold that is sent after it outdates it.

    Args:
        hold: Holds the robot, latches it if told to, and returns when it stands; raises when that is not confirmed.
        tasks: Where a hold goes on when those who asked for it are cancelled.
    """

    def __init__(self, hold: Callable[[bool], Awaitable[object]], tasks: Tasks) -> None:
        self._hold = hold
        self._tasks = tasks
        self._stopping: asyncio.Task[bool] | None = None

    def stop(self) -> asyncio.Task[bool]:
        """Holds and latches: the result is whether the robot has confirmed that it stands."""
        if self._stopping is None or self._stopping.done():
            self._stopping = self._tasks.spawn(self._try(latch=True))
        return self._stopping

    async def end_motion(self) -> bool:
        """Holds the robot after a motion: whether it has confirmed that it stands."""
        return await asyncio.shield(self._tasks.spawn(self._try(latch=False)))

    async def _try(self, *, latch: bool) -> bool:
        try:
            await self._hold(latch)
        except Exception as error:
            log.warning("hold_not_confirmed", reason=str(error))
            return False
        return True
