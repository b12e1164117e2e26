"""Scheduling of threads: their run and wait times, and the real-time policy of the few that an arm depends on."""

from pcmrs.threads._runaways import Runaway, Runaways, watched_processes
from pcmrs.threads._scheduling import Load, Threads, ThreadTimes, descendants
from pcmrs.threads.realtime import NOT_PERMITTED, Priority, RealTime, keep_pauses_short

__all__ = [
    "NOT_PERMITTED",
    "Load",
    "Priority",
    "RealTime",
    "Runaway",
    "Runaways",
    "ThreadTimes",
    "Threads",
    "descendants",
    "keep_pauses_short",
    "watched_processes",
]
