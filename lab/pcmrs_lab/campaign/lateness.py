"""How late a bare timer of the event loop is: what the machine's scheduler adds to everything measured beside it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

from pcmrs.background import background_task

PERIOD = 0.01


@dataclass
class TimerLateness:
    """How late a timer was each time, s."""

    late: list[float] = field(default_factory=list)


@asynccontextmanager
async def timer_lateness() -> AsyncIterator[TimerLateness]:
    """Measures for the length of the context."""
    found = TimerLateness()
    async with background_task(_measure(found)):
        yield found


async def _measure(found: TimerLateness) -> None:
    clock = asyncio.get_running_loop().time
    while True:
        begun = clock()
        await asyncio.sleep(PERIOD)
        found.late.append(clock() - begun - PERIOD)


def percentile(values: Sequence[float], share: float) -> float:
    """The smallest value that `share` of them do not exceed; 0 of none."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, max(0, round(share * len(ordered) + 0.5) - 1))] if ordered else 0.0
