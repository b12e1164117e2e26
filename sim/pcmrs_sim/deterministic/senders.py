"""The threads through which a simulated process sends requests.

`pcmrs.bus` gives each request to a pool of threads. The pool keeps no order: a later request overtakes an earlier one
whose thread was not scheduled. A sender with its own thread keeps the order of its requests.
"""

from __future__ import annotations

import heapq

import msgspec

from pcmrs.bus.keys import named_in
from pcmrs_sim.deterministic.windows import Windows

THREADS = 4
"""Number of threads in the pool of a process."""


class Senders:
    """Sending threads of one process.

    Args:
        windows: Durations of the hand-overs from event loop to thread.
    """

    def __init__(self, windows: Windows) -> None:
        self._windows = windows
        self._free: dict[str, list[float]] = {"": [0.0] * THREADS}

    def delay(self, name: str, now: float, sender: str = "") -> float:
        """Return the time until a request that is handed over now is sent, s.

        Args:
            name: Name of the request, see `name_of`.
            now: Present time of the simulation, s.
            sender: Name of a sender with its own thread, whose requests keep their order; empty for the pool.
        """
        duration = self._windows.open(f"send:{name}")
        free = self._free.setdefault(sender, [0.0])
        start = max(now, free[0])  # by the thread that is free first
        heapq.heapreplace(free, start + duration)
        return start + duration - now


def name_of(key: str, message: msgspec.Struct) -> str:
    """Return the short name of a request, such as ``robot.follow``; of a command, its branch and operation.

    Args:
        key: Key of the request.
        message: The request.
    """
    method = getattr(message, "method", None)
    if method is not None:
        return f"{named_in(key)}.{method}"
    return ".".join(key.split("/")[-2:]) if key.startswith("cmd/") else key
