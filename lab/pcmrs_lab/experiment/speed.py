"""How fast a simulated cell may run on this machine, as busy as it is now."""

from __future__ import annotations

import time
from typing import NamedTuple

from pcmrs.threads import Threads

TRIAL = 0.5
"""For so long a loop computes to see which part of a processor it gets, s."""
ENOUGH = 0.5
"""With this part of a processor a cell keeps the rate that it would keep on a machine that does nothing else."""


class Speed(NamedTuple):
    """Seconds of the simulated cell per second of the machine.

    Attributes:
        rate: That the machine can do.
        why: It is less than what was wanted; empty where it is not.
    """

    rate: float
    why: str = ""


def processor_share() -> float:
    """The part of a processor that a thread which computes gets now, measured for `TRIAL`."""
    begun, ran = time.monotonic(), time.thread_time()
    while (passed := time.monotonic() - begun) < TRIAL:
        sum(range(1000))
    return (time.thread_time() - ran) / passed


def kept_speed(wanted: float, share: float) -> Speed:
    """Lowers a rate to what the machine can do, but not below real time.

    A simulation that falls behind its own clock moves more slowly and shows poses late, while the limits of time pass.

    Args:
        wanted: Seconds of the cell per second of the machine.
        share: Of `processor_share`.
    """
    rate = max(min(wanted, 1.0), round(wanted * min(1.0, share / ENOUGH), 1))
    if rate == wanted:
        return Speed(wanted)
    why = f"The machine is busy ({Threads().load()}): the simulated cell runs {rate:g} times as fast as real time, "
    return Speed(rate, why + f"not {wanted:g} times.")
