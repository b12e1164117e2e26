"""Waiting for something that no event reports: a thread, another process, a file, or the ``trouble`` of a driver."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from pcmrs.testing.errors import Unmet

__all__ = ["wait_until"]

PATIENCE = 60.0
"""Longest wait, s: on a busy machine a new process needs many seconds."""
POLL_PERIOD = 0.01
"""Time between two checks of the condition, s."""


async def wait_until(condition: Callable[[], object], within: float = PATIENCE) -> None:
    """Wait until a condition is fulfilled.

    Args:
        condition: Returns a true value when it is fulfilled. It is called every `POLL_PERIOD`.
        within: Longest wait, s of the event loop.

    Raises:
        Unmet: It was not fulfilled in time.
    """
    loop = asyncio.get_running_loop()
    end = loop.time() + within
    while not condition():
        if loop.time() >= end:
            raise Unmet(f"The condition was not fulfilled within {within:g} s.")
        await asyncio.sleep(POLL_PERIOD)
