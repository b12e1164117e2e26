"""Takes the real-time policy away from a thread that runs away: nothing else would get its turn beside it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import NamedTuple

from pcmrs.threads.figures import Threads

LONGEST = 0.3
"""A thread that has not rested for so long runs away, s: no turn of a loop is meant to take longer than 0.2 s."""
REST = 0.1
"""Part of the time between two looks that a thread rests at least unless it runs away."""


class Runaway(NamedTuple):
    """A thread that had the real-time policy and has it no more.

    Attributes:
        process: Its process.
        thread: Its id.
        name: Of the thread, as the kernel knows it.
        ran: Without a rest, s.
    """

    process: int
    thread: int
    name: str
    ran: float


class _Seen(NamedTuple):
    at: float
    ran: float
    busy_since: float


class Runaways:
    """Watches the scheduling figures of all threads with the policy.

    Args:
        processes: Ids of those to watch, asked at each look.
    """

    def __init__(self, processes: Callable[[], Iterable[int]]) -> None:
        self._processes = processes
        self._seen: dict[int, _Seen] = {}

    def look(self, now: float) -> list[Runaway]:
        """Demotes to SCHED_OTHER those that have run away, and returns them.

        Args:
            now: s of the machine's monotonic clock; looks are to come several times within `LONGEST`.
        """
        before, self._seen, found = self._seen, {}, []
        for process in self._processes():
            threads = Threads(process)
            for thread, figures in threads.figures().items():
                if not _is_realtime(thread):
                    continue
                last = before.get(thread, _Seen(now, figures.ran, now))
                rested = figures.ran - last.ran < (1.0 - REST) * (now - last.at)
                seen = self._seen[thread] = _Seen(now, figures.ran, now if rested else last.busy_since)
                if now - seen.busy_since > LONGEST:
                    with suppress(OSError):  # it has ended
                        os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))
                    name = threads.names().get(thread, "")
                    found.append(Runaway(process, thread, name, now - seen.busy_since))
        return found


def _is_realtime(thread: int) -> bool:
    try:
        return os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR
    except OSError:
        return False
