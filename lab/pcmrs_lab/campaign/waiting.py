"""Waiting by polling: for a file, a log, a process."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from pcmrs.clock import SystemClock
from pcmrs.testing.cell import RunningCell
from pcmrs.testing.driving import PATIENCE
from pcmrs.testing.errors import Unmet

PERIOD = 0.02


async def until_true(condition: Callable[[], bool], missing: str, within: float = PATIENCE) -> float:
    """Wait until a condition holds, and return how long that took, s of the machine.

    Args:
        condition: Function that is called repeatedly.
        missing: Start of the error text, which names the missing condition.
        within: Time limit, s of the machine.

    Raises:
        Unmet: The condition did not hold in time.
    """
    clock = SystemClock()
    started = clock.monotonic()
    while not condition():
        if clock.monotonic() - started > within:
            raise Unmet(f"{missing} within {within:g} s.")
        await clock.sleep(PERIOD)
    return clock.monotonic() - started


async def until_ended(cell: RunningCell) -> int:
    """Wait until a daemon has ended, and return its exit status.

    Raises:
        Unmet: The daemon is still running.
    """
    try:
        return await asyncio.wait_for(cell.process.wait(), PATIENCE)
    except TimeoutError:
        raise Unmet(f"The daemon has not ended within {PATIENCE:g} s.") from None


async def until_logged(cell: RunningCell, words: str) -> float:
    """Wait until the log of a daemon contains some words, and return how long that took, s of the machine.

    Args:
        cell: Cell with the daemon.
        words: Part of a line.

    Raises:
        Unmet: The log does not contain them in time.
    """
    return await until_true(lambda: words in cell.log, f"The log does not contain '{words}'")
