"""Speed at which a simulated cell can run on this machine under its present load."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

from pcmrs.threads import Threads
from pcmrs_sim.process.priority import raise_priority

TRIAL = 0.5
"""Time for which a loop computes to measure its share of a processor, s."""
ENOUGH = 0.75
"""Share of a processor with which a cell reaches the rate that it reaches on an idle machine."""


class Speed(NamedTuple):
    """Seconds of the simulated cell per second of the machine.

    Attributes:
        rate: Rate that the machine can reach.
        why: Reason why it is less than requested; empty if it is not.
    """

    rate: float
    why: str = ""


def processor_share() -> float:
    """Return the share of a processor that a simulated world gets now, measured for `TRIAL`."""
    with ThreadPoolExecutor(1) as pool:  # in a new thread, because a lower priority may not be raised again
        return pool.submit(_share_of_world).result()


def _share_of_world() -> float:
    raise_priority()
    started, ran = time.monotonic(), time.thread_time()
    while (passed := time.monotonic() - started) < TRIAL:
        sum(range(1000))
    return (time.thread_time() - ran) / passed


def reachable_speed(wanted: float, share: float) -> Speed:
    """Reduce a rate to what the machine can reach, but not below real time.

    A simulation that falls behind its own clock moves more slowly and publishes poses late, while time limits expire.

    Args:
        wanted: Requested seconds of the cell per second of the machine.
        share: Result of `processor_share`.

    Returns:
        Rate, with the reason if it is reduced.
    """
    if share >= ENOUGH or wanted <= 1.0:
        return Speed(wanted)
    rate = min(wanted, max(1.0, round(wanted * share / ENOUGH, 1)))
    if rate == wanted:
        return Speed(wanted)
    why = f"The machine is busy ({Threads().load()}): the simulated cell runs {rate:g} times as fast as real time, "
    return Speed(rate, why + f"not {wanted:g} times.")
