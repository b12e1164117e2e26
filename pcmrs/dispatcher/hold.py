"""Holds the robot for whoever asks, once for all who ask at the same time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable

import structlog

from pcmrs.dispatcher.tasks import Tasks

log = structlog.get_logger(__name__)


class Hold:
    """Those who ask while a hold is under way, and nothing has moved since, wait for that one.

    Args:
        hold: Holds the robot and returns when it stands still; raises when that is not confirmed.
        tasks: Where a hold goes on when those who asked for it are cancelled.
    """

    def __init__(self, hold: Callable[[], Awaitable[object]], tasks: Tasks) -> None:
        self._hold = hold
        self._tasks = tasks
        self._holding: asyncio.Task[bool] | None = None

    async def confirmed(self) -> bool:
        """Holds the robot: whether it has confirmed that it stands."""
        if self._holding is None or self._holding.done():
            self._holding = self._tasks.spawn(self._try())
        return await asyncio.shield(self._holding)

    def outdate(self) -> None:
        """The robot is about to move, or may have moved: what was asked for before does not hold it now."""
        self._holding = None

    async def _try(self) -> bool:
        try:
            await self._hold()
        except Exception as error:
            log.warning("hold_not_confirmed", reason=str(error))
            return False
        return True
