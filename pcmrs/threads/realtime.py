"""The real-time policy SCHED_RR for the few threads that must not wait behind other programs.

The policy is for the loop of the daemon, the process that owns the link to a device, and their Zenoh threads; never for
planning, physics, rendering, recording or the console. Threads and processes that they start begin without it
(SCHED_RESET_ON_FORK).

`keep_pauses_short` limits the pauses of Python itself: thread switches and garbage collection.
"""

from __future__ import annotations

import asyncio
import gc
import os
import sys
import threading
from collections.abc import Awaitable, Callable
from contextlib import suppress
from enum import IntEnum

from pcmrs.threads._scheduling import Threads

SWITCH = 0.0005
"""Time after which a thread releases the interpreter's lock to one that waits, s; Python's default is 0.005."""


def keep_pauses_short() -> None:
    """Limit the pauses of the event loop by other threads of this process and by the garbage collector.

    Call it once, after the start of the process. The real-time policy does not help here: a thread that waits for the
    lock does not run, whatever its priority is, and the collector runs in the thread that allocates memory. A full
    collection of all objects that a daemon loads takes about 60 ms, so the present objects are excluded from it.
    """
    sys.setswitchinterval(SWITCH)
    gc.collect()
    gc.freeze()


ZENOH = ("app-", "net-", "acc-", "rx-", "tx-")
"""Prefixes of the kernel's names of Zenoh's own threads."""
CALLBACKS = ("pcmrs-bus", "pcmrs-stop", "pyo3-closure")
"""Parts of Python's names of the threads that send requests and handle received messages."""
READERS = "pcmrs-bus-read"
"""Part of the names of the threads that send long replies, such as the journal: nothing depends on their time."""

NOT_PERMITTED = (
    "The real-time policy SCHED_RR is not permitted here: RLIMIT_RTPRIO is too small, or sched_setscheduler is "
    "refused. On a busy machine heartbeats are then late, and a moving arm is held without need. Permit it as the "
    "units in deploy/systemd do (LimitRTPRIO=20), and check with pcmrs doctor."
)


PERIOD = 1.0
"""Time after which a new thread gets the policy, s of the machine."""


class Priority(IntEnum):
    """Real-time priorities: a node, which can brake, is ahead of the daemon, and the heart is ahead of both."""

    LOOP = 10
    DEVICE = 11
    HEART = 12


class RealTime:
    """Policy for the main thread of this process and to its Zenoh threads.

    Args:
        priority: Priority within SCHED_RR.
    """

    def __init__(self, priority: Priority) -> None:
        self._priority = priority
        self._given: set[int] = set()

    def give(self) -> None:
        """Give the policy to all threads that were started since the last call.

        A thread from which the policy was taken away does not get it again.

        Raises:
            PermissionError: The policy is not permitted.
        """
        for thread in self._wanted() - self._given:
            with suppress(ProcessLookupError):  # the thread has ended
                policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
                os.sched_setscheduler(thread, policy, os.sched_param(self._priority))
            self._given.add(thread)

    async def keep(self, sleep: Callable[[float], Awaitable[None]]) -> None:
        """Give the policy every `PERIOD`, because threads start at any time; do nothing without permission.

        Args:
            sleep: Waits for a time in s of the machine.
        """
        with suppress(PermissionError):
            while True:
                self.give()
                await sleep(PERIOD)
        await asyncio.Event().wait()

    def _wanted(self) -> set[int]:
        wanted = {thread for thread, name in Threads().names().items() if name.startswith(ZENOH)}
        for each in threading.enumerate():
            if each.native_id is not None and any(part in each.name for part in CALLBACKS) and READERS not in each.name:
                wanted.add(each.native_id)
        return wanted | {os.getpid()}
