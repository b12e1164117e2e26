"""Running a coroutine in simulated time: waiting costs nothing, and every run is the same."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import TypeVar

from pcmrs.simulated_time.loop import SimulatedLoop

__all__ = ["run_on_simulated_loop"]

T = TypeVar("T")


def run_on_simulated_loop(work: Awaitable[T]) -> T:
    """Run a coroutine on a new `SimulatedLoop`, which starts at 0 s, and return its result.

    Args:
        work: Coroutine. It may use no sockets, threads or processes.

    Raises:
        SimulationError: It waits for something that cannot happen: nothing else runs, and no timer is set.
    """
    loop = SimulatedLoop()
    try:
        return loop.run_until_complete(work)
    finally:
        loop.close()
