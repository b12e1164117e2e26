"""Waiting for what only a look can tell: a file, a log, a process."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from pcmrs.clock import SystemClock
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.driving import PATIENCE
from pcmrs.testing.errors import Unmet

PERIOD = 0.02


async def until_true(condition: Callable[[], bool], missing: str, within: float = PATIENCE) -> float:
    """Waits until a condition holds; returns how long that took, s of the machine.

    Args:
        condition: Looked at again and again.
        missing: What is not so when it does not come true, for the text.
        within: s of the machine.

    Raises:
        Unmet: It did not in time.
    """
    clock = SystemClock()
    begun = clock.monotonic()
    while not condition():
        if clock.monotonic() - begun > within:
            raise Unmet(f"{missing} within {within:g} s.")
        await clock.sleep(PERIOD)
    return clock.monotonic() - begun


async def until_ended(cell: RunningCell) -> int:
    """Waits until a daemon has ended; returns its exit status.

    Raises:
        Unmet: It runs on.
    """
    try:
        return await asyncio.wait_for(cell.process.wait(), PATIENCE)
    except TimeoutError:
        raise Unmet(f"The daemon has not ended within {PATIENCE:g} s.") from None


async def until_said(cell: RunningCell, words: str) -> float:
    """Waits until the log of a daemon has the words; returns how long that took, s of the machine.

    Raises:
        Unmet: It did not say them in time.
    """
    return await until_true(lambda: words in cell.log, f"The log does not say '{words}'")
