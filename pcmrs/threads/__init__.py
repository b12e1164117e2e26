"""Scheduling of threads: their run and wait times, and the real-time policy of the few that an arm depends on."""

from pcmrs.threads.realtime import NOT_PERMITTED, Priority, RealTime, keep_pauses_short
from pcmrs.threads.runaways import Runaway, Runaways
from pcmrs.threads.scheduling import Load, Threads, ThreadTimes, descendants

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
]
