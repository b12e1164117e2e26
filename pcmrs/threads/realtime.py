"""The real-time policy SCHED_RR for the few threads that must not wait behind other programs.

For the loop of the daemon, the process that owns the link to a device, and their threads of Zenoh; never for planning,
physics, rendering, recording or the console. Threads and processes that they start begin without it
(SCHED_RESET_ON_FORK).

What Python does by itself, at times that nobody has chosen: it must not keep an event loop waiting.
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

from pcmrs.threads.figures import Threads

SWITCH = 0.0005
"""A thread that holds the interpreter's lock gives it to one that waits after this, s; Python's own value is 0.005."""


def keep_pauses_short() -> None:
    """Let neither other threads of this process nor the garbage collector keep its event loop waiting for long.

    Call it once, when the process has started. The real-time policy does not help against either: a thread that waits
    for the lock does not run, whatever its priority is, and the collector runs in the thread that needs memory. A full
    collection of all that a daemon loads takes about 60 ms; what exists now is not looked at again.
    """
    sys.setswitchinterval(SWITCH)
    gc.collect()
    gc.freeze()


ZENOH = ("app-", "net-", "acc-", "rx-", "tx-")
"""Names of Zenoh's own threads begin so, as the kernel knows them."""
CALLBACKS = ("pcmrs-bus", "pcmrs-stop", "pyo3-closure")
"""Parts of the names, as Python knows them, of threads that send requests and take what Zenoh has received."""

NOT_PERMITTED = (
    "The real-time policy SCHED_RR is not permitted here: RLIMIT_RTPRIO is too small, or sched_setscheduler is "
    "refused. On a busy machine heartbeats come late then, and a moving arm is held that need not be. Permit it as the "
    "units in deploy/systemd do (LimitRTPRIO=20), and look with pcmrs doctor."
)


PERIOD = 1.0
"""A thread that has begun has the policy after this, s of the machine."""


class Priority(IntEnum):
    """Whoever brakes goes ahead of whoever leads, and the watch over both ahead of them."""

    LOOP = 10
    DEVICE = 11
    HEART = 12


class RealTime:
    """The policy for the main thread of this process and its threads of Zenoh.

    Args:
        priority: Of SCHED_RR.
    """

    def __init__(self, priority: Priority) -> None:
        self._priority = priority
        self._given: set[int] = set()

    def give(self) -> None:
        """Gives the policy to all that have begun since the last call; to none again from which it was taken away.

        Raises:
            PermissionError: It is not permitted.
        """
        for thread in self._wanted() - self._given:
            with suppress(ProcessLookupError):  # the thread has ended
                policy = os.SCHED_RR | os.SCHED_RESET_ON_FORK
                os.sched_setscheduler(thread, policy, os.sched_param(self._priority))
            self._given.add(thread)

    async def keep(self, sleep: Callable[[float], Awaitable[None]]) -> None:
        """Gives the policy again and again, for threads begin at any time; without permission it does nothing.

        Args:
            sleep: Waits so long, s of the machine.
        """
        with suppress(PermissionError):
            while True:
                self.give()
                await sleep(PERIOD)
        await asyncio.Event().wait()

    def _wanted(self) -> set[int]:
        wanted = {thread for thread, name in Threads().names().items() if name.startswith(ZENOH)}
        for each in threading.enumerate():
            if each.native_id is not None and any(part in each.name for part in CALLBACKS):
                wanted.add(each.native_id)
        return wanted | {os.getpid()}
