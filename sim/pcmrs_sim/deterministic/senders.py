"""The threads through which a simulated process sends requests: what they keep in order, and what they do not.

`pcmrs.bus` hands every request to a pool of threads, so that two requests are not ordered: the later one overtakes
the earlier whose thread was not scheduled.
"""

from __future__ import annotations

import heapq

import msgspec

from pcmrs.bus.keys import named_in
from pcmrs_sim.deterministic.windows import Windows

THREADS = 4
"""Of the pool of one process."""


class Senders:
    """When a request that the loop hands over now is sent.

    Args:
        windows: How long a hand-over takes.
    """

    def __init__(self, windows: Windows) -> None:
        self._windows = windows
        self._free: dict[str, list[float]] = {"": [0.0] * THREADS}

    def delay(self, what: str, now: float, sender: str = "") -> float:
        """Until it is sent, s.

        Args:
            what: Its name; see `name_of`.
            now: s of the simulation.
            sender: Has a thread to itself, so that its requests keep their order; empty for the pool.
        """
        lasts = self._windows.open(f"send:{what}")
        free = self._free.setdefault(sender, [0.0])
        begun = max(now, free[0])
        heapq.heapreplace(free, begun + lasts)
        return begun + lasts - now


def name_of(key: str, message: msgspec.Struct) -> str:
    """Short name of a request, such as ``robot.follow``; that of a command is its branch and operation."""
    method = getattr(message, "method", None)
    if method is not None:
        return f"{named_in(key)}.{method}"
    return ".".join(key.split("/")[-2:]) if key.startswith("cmd/") else key
