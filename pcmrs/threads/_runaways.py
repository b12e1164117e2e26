"""Detection of real-time threads that run away: they lose the policy, because nothing else could run beside them."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import NamedTuple

from pcmrs.threads._scheduling import Threads, ThreadTimes, descendants

LONGEST = 0.3
"""Time without a pause after which a thread runs away, s: no turn of a loop should take longer than 0.2 s."""
REST = 0.1
"""Part of the time between two checks that a thread must pause; with less it did not pause."""
CALM = 10.0
"""Time with regular pauses after which a thread gets the policy back, s."""
LISTING = 1.0
"""Time between two looks at all threads of a process whose main thread does not have the policy, s."""


class Runaway(NamedTuple):
    """A real-time thread that has run away.

    Attributes:
        process: Id of its process.
        thread: Id of the thread.
        name: Name of the thread in the kernel.
        ran: Time that it ran without a pause, s.
        refused: Reason why the policy could not be taken away; empty if the thread has lost it.
    """

    process: int
    thread: int
    name: str
    ran: float
    refused: str = ""


class _Seen(NamedTuple):
    """State of a thread at the last check.

    Attributes:
        at: Time of the check, s.
        times: Its scheduling times.
        since: Time since which it has not paused or, without the policy, has always paused, s.
    """

    at: float
    times: ThreadTimes
    since: float


class Runaways:
    """Watch over the scheduling times of all threads with the policy.

    Args:
        processes: Returns the ids of the processes to watch; called at each check.
    """

    def __init__(self, processes: Callable[[], Iterable[int]]) -> None:
        self._processes = processes
        self._seen: dict[int, _Seen] = {}
        self._demoted: dict[int, int] = {}
        self._watched: set[int] = set()
        self._listed = -LISTING
        self._refused: set[int] = set()

    def check(self, now: float) -> list[Runaway]:
        """Demote threads that have run away to SCHED_OTHER, and return them; calm ones get the policy back.

        Call this several times within `LONGEST`. A thread that cannot be demoted is returned once until it rests.

        Args:
            now: Time of the machine's monotonic clock, s.
        """
        before, self._seen, found = self._seen, {}, []
        for process in self._to_watch(now):
            threads = Threads(process)
            watched = threads.times(self._is_watched)
            if watched:
                self._watched.add(process)
            for thread, times in watched.items():
                last = before.get(thread, _Seen(now, times, now))
                if thread in self._demoted:
                    self._check_demoted(thread, last, times, now)
                else:
                    rested = times.ran - last.times.ran < (1.0 - REST) * (now - last.at)
                    seen = self._seen[thread] = _Seen(now, times, now if rested else last.since)
                    if now - seen.since <= LONGEST:
                        self._refused.discard(thread)
                    elif (refused := self._demote(thread)) is not None:
                        name = threads.names().get(thread, "")
                        found.append(Runaway(process, thread, name, now - seen.since, refused))
        self._demoted = {thread: many for thread, many in self._demoted.items() if thread in self._seen}
        self._refused &= self._seen.keys()
        return found

    def _to_watch(self, now: float) -> list[int]:
        """Return the processes whose threads are to be read: listing those of all processes takes most of a check."""
        processes = list(self._processes())
        before, self._watched = self._watched, set()
        if now - self._listed >= LISTING:
            self._listed = now
            return processes
        # `RealTime` gives the policy to the main thread with the first of the others.
        return [process for process in processes if process in before or _is_realtime(process)]

    def _is_watched(self, thread: int) -> bool:
        return thread in self._demoted or _is_realtime(thread)

    def _demote(self, thread: int) -> str | None:
        """Remove the policy. Return why that is refused; empty if it is not, and None if nothing is to report."""
        try:
            priority = os.sched_getparam(thread).sched_priority
            # The flag stays: to clear it needs CAP_SYS_NICE, which neither the units nor the container permit.
            os.sched_setscheduler(thread, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))
        except ProcessLookupError:  # it has ended
            return None
        except OSError as error:
            reported = thread in self._refused
            self._refused.add(thread)
            return None if reported else error.strerror
        self._demoted[thread] = priority
        return ""

    def _check_demoted(self, thread: int, last: _Seen, times: ThreadTimes, now: float) -> None:
        # Without the policy it competes with other threads: its wait for a processor is not a pause.
        worked = sum(times) - sum(last.times)
        self._seen[thread] = seen = _Seen(now, times, now if worked > (1.0 - REST) * (now - last.at) else last.since)
        if now - seen.since > CALM:
            self._seen[thread] = seen._replace(since=now)
            with suppress(OSError):
                priority = os.sched_param(self._demoted.pop(thread))
                os.sched_setscheduler(thread, os.SCHED_RR | os.SCHED_RESET_ON_FORK, priority)


def watched_processes(parent: int) -> list[int]:
    """Return the ids of a process and all below it, without the calling one, which would watch itself.

    Args:
        parent: Id of the process.
    """
    return [process for process in (parent, *descendants(parent)) if process != os.getpid()]


def _is_realtime(thread: int) -> bool:
    try:
        return os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR
    except OSError:
        return False
