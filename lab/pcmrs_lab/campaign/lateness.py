"""Lateness of a bare timer of the event loop: the scheduling delay that the machine adds to measurements beside it."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from pcmrs.background import background_task

PERIOD = 0.01


@dataclass
class TimerLateness:
    """TimerLateness of a timer at each expiry, s."""

    late: list[float] = field(default_factory=list)


@asynccontextmanager
async def timer_lateness() -> AsyncIterator[TimerLateness]:
    """Measure the lateness of a timer for the length of the context."""
    found = TimerLateness()
    async with background_task(_measure(found)):
        yield found


async def _measure(found: TimerLateness) -> None:
    clock = asyncio.get_running_loop().time
    while True:
        started = clock()
        await asyncio.sleep(PERIOD)
        found.late.append(clock() - started - PERIOD)


def percentile(values: Sequence[float], share: float) -> float:
    """Return the smallest value that a share of the values does not exceed; 0 for no values.

    Args:
        values: Values in any order.
        share: Share between 0 and 1.
    """
    ordered = sorted(values)
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)] if ordered else 0.0
