"""TCP segments that a connection has received, as the kernel counts them at the receiver's socket.

Forces that the robot's own estimate shows to a subscriber.

Set points that the robot's node counts as dropped: what of them took effect is for the receiver to say.
"""

from __future__ import annotations

import asyncio
import math
import re
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from pcmrs.messages import DeviceHealth, JointState
from pcmrs.testing.errors import Unmet
from pcmrs_lab.campaign.needs import program
from pcmrs_lab.campaign.waiting import until_true

if TYPE_CHECKING:
    from pcmrs.testing.cell import RunningCell


@asynccontextmanager
async def pushes(cell: RunningCell) -> AsyncIterator[list[float]]:
    """Magnitudes of the force on the flange that a client of the cell receives during the context, N."""
    found: list[float] = []

    def take(joints: JointState) -> None:
        if joints.flange_force is not None:
            found.append(math.hypot(*joints.flange_force))

    end = cell.client.listen("state/joints", JointState, take)
    try:
        yield found
    finally:
        await end()


def over(forces: Sequence[float], limit: float) -> dict[str, float]:
    """Details of a force over the limit, N.

    Raises:
        Unmet: There was none.
    """
    most, states = max(forces, default=0.0), sum(force > limit for force in forces)
    if not states:
        raise Unmet(f"No state of the joints shows a force over {limit:g} N: at most {most:.1f} N.")
    return {"most_newtons": most, "states over the limit": states}


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


SS = program("ss")
"""The tool that asks the kernel; it needs no rights."""

COUNTS = ("data_segs_in", "data_segs_out")


@dataclass(frozen=True, slots=True)
class Segments:
    """Segments with data of one connection, from its client's side.

    Attributes:
        received: From the server.
        sent: To it.
    """

    received: int
    sent: int

    def since(self, before: Segments) -> Segments:
        """What came after `before`."""
        return Segments(self.received - before.received, self.sent - before.sent)

    @property
    def per_request(self) -> float:
        """Segments received for one that was sent."""
        return self.received / self.sent if self.sent else 0.0


async def segments(port: int) -> Segments:
    """Of the one connection that this machine has to a port.

    Raises:
        Unmet: There is none, or several.
    """
    words = ("ss", "-tinH", "state", "established", f"( dport = :{port} )")
    process = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE)
    shown, _ = await process.communicate()
    found = [[int(each) for each in re.findall(rf"\b{name}:(\d+)", shown.decode())] for name in COUNTS]
    if [len(each) for each in found] != [1, 1]:
        raise Unmet(f"The kernel does not show one connection to port {port}: {shown.decode()}")
    return Segments(found[0][0], found[1][0])
