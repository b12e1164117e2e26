"""Takes the real-time policy away from a thread that runs away: nothing else would get its turn beside it."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import NamedTuple

from pcmrs.threads.figures import Figures, Threads

LONGEST = 0.3
"""A thread that has not rested for so long runs away, s: no turn of a loop is meant to take longer than 0.2 s."""
REST = 0.1
"""Part of the time between two looks that a thread rests at least unless it runs away."""


CALM = 10.0
"""One that has rested again and again for so long gets the policy back, s."""


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
    """Of a thread at the last look: when that was, its figures, and since when it has not rested, or has."""

    at: float
    figures: Figures
    since: float


class Runaways:
    """Watches the scheduling figures of all threads with the policy.

    Args:
        processes: Ids of those to watch, asked at each look.
    """

    def __init__(self, processes: Callable[[], Iterable[int]]) -> None:
        self._processes = processes
        self._seen: dict[int, _Seen] = {}
        self._demoted: dict[int, int] = {}

    def look(self, now: float) -> list[Runaway]:
        """Demotes to SCHED_OTHER those that have run away, and returns them; those that rest again get the policy back.

        Args:
            now: s of the machine's monotonic clock; looks are to come several times within `LONGEST`.
        """
        before, self._seen, found = self._seen, {}, []
        for process in self._processes():
            threads = Threads(process)
            for thread, figures in threads.figures().items():
                last = before.get(thread, _Seen(now, figures, now))
                if thread in self._demoted:
                    self._look_at_demoted(thread, last, figures, now)
                elif _is_realtime(thread):
                    rested = figures.ran - last.figures.ran < (1.0 - REST) * (now - last.at)
                    seen = self._seen[thread] = _Seen(now, figures, now if rested else last.since)
                    if now - seen.since > LONGEST:
                        self._demote(thread)
                        found.append(Runaway(process, thread, threads.names().get(thread, ""), now - seen.since))
        self._demoted = {thread: many for thread, many in self._demoted.items() if thread in self._seen}
        return found

    def _demote(self, thread: int) -> None:
        with suppress(OSError):  # it has ended
            self._demoted[thread] = os.sched_getparam(thread).sched_priority
            os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))

    def _look_at_demoted(self, thread: int, last: _Seen, figures: Figures, now: float) -> None:
        # It is one of many now: what it waits for a processor is no rest.
        worked = sum(figures) - sum(last.figures)
        self._seen[thread] = seen = _Seen(now, figures, now if worked > (1.0 - REST) * (now - last.at) else last.since)
        if now - seen.since > CALM:
            self._seen[thread] = seen._replace(since=now)
            with suppress(OSError):
                priority = os.sched_param(self._demoted.pop(thread))
                os.sched_setscheduler(thread, os.SCHED_RR | os.SCHED_RESET_ON_FORK, priority)


def _is_realtime(thread: int) -> bool:
    try:
        return os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR
    except OSError:
        return False
