"""Watch that the holder of the cell's lease renews it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pcmrs.clock import Clock
from pcmrs.dispatcher import Dispatcher
from pcmrs.dispatcher.lease import lapse
from pcmrs.service.supervisor import mark

LOOKS = 10
"""Number of checks in the time after which a lease lapses."""


class LeaseWatch:
    """Watch that ends the lease of a holder who does not renew it; a moving robot is held.

    Args:
        dispatcher: The dispatcher, which has the lease.
        moving: Returns whether the robot moves.
        clock: The cell's clock.
        limit: Time without renewal, s of the clock.
    """

    def __init__(
        self, dispatcher: Dispatcher[Any, Any], moving: Callable[[], bool], clock: Clock, limit: float
    ) -> None:
        self._dispatcher = dispatcher
        self._moving = moving
        self._clock = clock
        self._limit = limit

    async def run(self) -> None:
        """Watch until cancelled."""
        while True:
            mark()
            holder = self._dispatcher.lease.lapsed(self._limit)
            if holder is not None:
                await self._dispatcher.report(lapse(holder, self._limit, moving=self._moving()))
            await self._clock.sleep(self._limit / LOOKS)
