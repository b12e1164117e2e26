"""Scheduling of threads: how long they ran and waited, and the real-time policy of the few that an arm waits for."""

from pcmrs.threads.figures import Figures, Load, Threads
from pcmrs.threads.realtime import NOT_PERMITTED, Priority, RealTime, keep_pauses_short
from pcmrs.threads.runaways import Runaway, Runaways

__all__ = [
    "NOT_PERMITTED",
    "Figures",
    "Load",
    "Priority",
    "RealTime",
    "Runaway",
    "Runaways",
    "Threads",
    "keep_pauses_short",
]
