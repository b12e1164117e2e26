"""Scheduling of threads: how long they ran and waited, and the real-time policy of the few that an arm waits for."""

from pcmrs.threads.figures import Figures, Load, Threads
from pcmrs.threads.realtime import NOT_PERMITTED, Priority, RealTime, share_interpreter
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
    "share_interpreter",
]
