"""Running work in simulated time, for tests."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import TypeVar

from pcmrs.simulated_time.loop import SimulatedLoop

T = TypeVar("T")


def simulated(work: Awaitable[T]) -> T:
    """Runs `work` on a loop of its own."""
    loop = SimulatedLoop()
    try:
        return loop.run_until_complete(work)
    finally:
        loop.close()
