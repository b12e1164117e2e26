"""Measurements at the receiver of a fault: forces, dropped set points, and TCP segments.

Forces are those that the robot's own estimate shows to a subscriber. Set points are those that the robot's node counts
as dropped. Segments are counted by the kernel at the receiver's socket.
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
from pcmrs.testing.needs import program
from pcmrs_lab.campaign.waiting import until_true

if TYPE_CHECKING:
    from pcmrs.testing.cell import RunningCell


@asynccontextmanager
async def flange_forces(cell: RunningCell) -> AsyncIterator[list[float]]:
    """Collect the magnitudes of the force on the flange that a client receives during the context, N."""
    found: list[float] = []

    def take(joints: JointState) -> None:
        if joints.flange_force is not None:
            found.append(math.hypot(*joints.flange_force))

    end = cell.client.listen("state/joints", JointState, take)
    try:
        yield found
    finally:
        await end()


def forces_over_limit(forces: Sequence[float], limit: float) -> dict[str, float]:
    """Return details of a force over the limit.

    Args:
        forces: Magnitudes, N.
        limit: Limit, N.

    Raises:
        Unmet: No force exceeds the limit.
    """
    most, states = max(forces, default=0.0), sum(force > limit for force in forces)
    if not states:
        raise Unmet(f"No state of the joints shows a force over {limit:g} N: at most {most:.1f} N.")
    return {"most_newtons": most, "states over the limit": states}


class DroppedSetpoints:
    """Numbers of dropped set points that the robot's node has published.

    Args:
        kind: ``setpoints`` for those that came late or from before a hold, ``stale_setpoints`` for those that the
            driver found repeated, stale or of no running session.
    """

    def __init__(self, kind: str) -> None:
        self._kind = kind
        self._counts: list[int] = []

    def take(self, health: DeviceHealth) -> None:
        """Record a health message of the node."""
        self._counts.append(health.dropped.get(self._kind, 0))

    async def current(self) -> int:
        """Return the number by a count that was made after the call.

        Raises:
            Unmet: The node publishes no count.
        """
        known = len(self._counts)
        # The first message after the call may have been sent before it.
        await until_true(lambda: len(self._counts) > known + 1, "The robot's node publishes no health")
        return self._counts[-1]

    async def increase_since(self, before: int) -> int:
        """Wait until more than `before` are counted, and return how many more.

        Raises:
            Unmet: The count does not increase.
        """
        await until_true(lambda: self._counts[-1] > before, f"No set point was dropped as one of its {self._kind}")
        return self._counts[-1] - before


@asynccontextmanager
async def dropped_setpoints(cell: RunningCell, kind: str) -> AsyncIterator[DroppedSetpoints]:
    """Collect the node's counts of one kind that a client receives during the context; see `DroppedSetpoints`.

    Args:
        cell: Cell with the robot.
        kind: Kind of dropped set points.
    """
    found = DroppedSetpoints(kind)
    end = cell.client.listen("dev/robot/state", DeviceHealth, found.take)
    try:
        yield found
    finally:
        await end()


SS = program("ss")
"""Tool that reads the kernel's socket statistics; it needs no special rights."""

COUNTS = ("data_segs_in", "data_segs_out")


@dataclass(frozen=True, slots=True)
class Segments:
    """Segments with data of one connection, counted at its client.

    Attributes:
        received: Number received from the server.
        sent: Number sent to it.
    """

    received: int
    sent: int

    def since(self, before: Segments) -> Segments:
        """Return the numbers after `before`."""
        return Segments(self.received - before.received, self.sent - before.sent)

    @property
    def per_request(self) -> float:
        """Number of segments received for each one that was sent."""
        return self.received / self.sent if self.sent else 0.0


async def segments(port: int) -> Segments:
    """Return the counts of the one connection that this machine has to a port.

    Raises:
        Unmet: There is no such connection, or several.
    """
    words = ("ss", "-tinH", "state", "established", f"( dport = :{port} )")
    process = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE)
    shown, _ = await process.communicate()
    found = [[int(each) for each in re.findall(rf"\b{name}:(\d+)", shown.decode())] for name in COUNTS]
    if [len(each) for each in found] != [1, 1]:
        raise Unmet(f"The kernel does not show one connection to port {port}: {shown.decode()}")
    return Segments(found[0][0], found[1][0])
