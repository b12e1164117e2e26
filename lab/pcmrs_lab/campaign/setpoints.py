"""Set points that the robot's node counts as dropped: what of them took effect is for the receiver to say."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING

from pcmrs.messages import DeviceHealth
from pcmrs_lab.campaign.waiting import until_true

if TYPE_CHECKING:
    from pcmrs.testing.cell import RunningCell


class Dropped:
    """What the robot's node has published of the set points that were dropped.

    Args:
        kind: ``setpoints`` for those that came late or from before a hold, ``stale_setpoints`` for those that the
            driver found repeated, stale or of no running session.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._counts: list[int] = []

    def take(self, health: DeviceHealth) -> None:
        """Puts a word of the node to the others."""
        self._counts.append(health.dropped.get(self._kind, 0))

    async def now(self) -> int:
        """How many there are by a count that was made after the call.

        Raises:
            Unmet: The node does not say.
        """
        known = len(self._counts)
        # The first word after the call may have been under way before it.
        await until_true(lambda: len(self._counts) > known + 1, "The robot's node does not say how it is")
        return self._counts[-1]

    async def beyond(self, before: int) -> int:
        """Waits until more than `before` are counted, and returns how many more.

        Raises:
            Unmet: No more are.
        """
        await until_true(lambda: self._counts[-1] > before, f"No set point was dropped as one of its {self._kind}")
        return self._counts[-1] - before


@asynccontextmanager
async def dropped_setpoints(cell: RunningCell, kind: str) -> AsyncIterator[Dropped]:
    """The node's counts of one kind, as a client of the cell receives them during the context; see `Dropped`."""
    found = Dropped(kind)
    end = cell.client.listen("dev/robot/state", DeviceHealth, found.take)
    try:
        yield found
    finally:
        await end()
