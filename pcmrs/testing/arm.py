"""Whether the arm of a running cell stands or moves: by the simulator's ground truth, or by its published joints."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from pcmrs.messages import JointState
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.errors import Unmet

__all__ = [
    "BRAKING",
    "LOOK",
    "NO_MOTION",
    "STANDS_WITHIN",
    "displaced",
    "standing",
    "stands",
    "tool_position",
    "unmoved",
]

STANDS_WITHIN = 2e-4
"""Largest displacement of a standing arm during `LOOK`, m; brakes hold the simulated arm."""

LOOK = 0.5
"""Time over which an arm is observed, s of the machine."""
BRAKING = 1.0
"""Time after which every stopped motion has ended, s of the machine."""

NO_MOTION = 2e-3
"""Largest displacement of a joint that was not moved, rad."""


async def stands(cell: RunningCell) -> float:
    """Check by the simulator's ground truth that the arm stands, and return its displacement during `LOOK`, m.

    Raises:
        Unmet: The arm moves.
    """
    await asyncio.sleep(BRAKING)
    before = await tool_position(cell)
    await asyncio.sleep(LOOK)
    return await _still_at(before, cell)


@asynccontextmanager
async def unmoved(cell: RunningCell) -> AsyncIterator[None]:
    """Check by the simulator's ground truth that a resting arm is after `LOOK` where it was when the context began.

    Raises:
        Unmet: The arm is elsewhere.
    """
    before = await tool_position(cell)
    yield
    await asyncio.sleep(LOOK)
    await _still_at(before, cell)


@asynccontextmanager
async def displaced(cell: RunningCell) -> AsyncIterator[list[float]]:
    """Measure by all published joints how far they move during the context and for a second after it.

    Yields:
        List that receives the largest displacement of a joint at the end, rad.

    Raises:
        Unmet: No joints were published.
    """
    found: list[float] = []
    seen: list[tuple[float, ...]] = []
    end = cell.client.listen("state/joints", JointState, lambda joints: seen.append(tuple(joints.positions)))
    try:
        yield found
        await asyncio.sleep(BRAKING)
    finally:
        await end()
    if len(seen) < 2:
        raise Unmet("The arm's joints were not published.")
    found.append(max(abs(now - first) for joints in seen for now, first in zip(joints, seen[0], strict=True)))


@asynccontextmanager
async def standing(cell: RunningCell) -> AsyncIterator[list[float]]:
    """Check by all published joints that none moves during the context and for a second after it.

    Yields:
        List that receives the largest displacement at the end, rad.

    Raises:
        Unmet: A joint has moved, or no joints were published.
    """
    async with displaced(cell) as found:
        yield found
    if found[0] > NO_MOTION:
        raise Unmet(f"A joint moved by {math.degrees(found[0]):.1f}° although no motion is allowed.")


async def tool_position(cell: RunningCell) -> tuple[float, float, float]:
    """Return the true position of the tool in the tracker frame, m."""
    return (await cell.scene.truth()).tracker_from_coil.position


async def _still_at(before: tuple[float, float, float], cell: RunningCell) -> float:
    displacement = math.dist(before, await tool_position(cell))
    if displacement > STANDS_WITHIN:
        raise Unmet(f"The arm has moved by {displacement * 1e3:.2f} mm.")
    return displacement
