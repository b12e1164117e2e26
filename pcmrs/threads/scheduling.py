"""Scheduling of the threads of a process by Linux: how long each one ran and waited for a processor."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple


class ThreadTimes(NamedTuple):
    """Scheduling times of one thread since its start.

    Attributes:
        ran: Time on a processor, s.
        waited: Time in which it was ready to run and waited for a processor, s.
    """

    ran: float
    waited: float


_NONE = ThreadTimes(0.0, 0.0)


class Load(NamedTuple):
    """Load of the machine.

    Attributes:
        running: Number of threads that run or wait for a processor.
        processors: Number of processors that this process may use.
    """

    running: int
    processors: int

    def __str__(self) -> str:
        many = f"{self.processors} processor" + "s" * (self.processors > 1)
        return f"{self.running} threads want to run on {many}"


class Threads:
    """The threads of one process.

    Args:
        pid: Id of the process; None for this one.
    """

    def __init__(self, pid: int | None = None) -> None:
        self._folder = Path(f"/proc/{pid or os.getpid()}/task")
        self._before: dict[int, ThreadTimes] | None = None

    def times(self) -> dict[int, ThreadTimes]:
        """Return the times by thread id; empty if the process has ended or the kernel does not count them."""
        return {thread: _times_of(text) for thread, text in self._read("schedstat")}

    def waited(self) -> float:
        """Return the longest total wait of a thread for a processor since the last call, s; 0 at the first call."""
        before, self._before = self._before, self.times()
        if before is None:
            return 0.0
        return max(
            (each.waited - before.get(thread, _NONE).waited for thread, each in self._before.items()), default=0.0
        )

    def pending(self) -> bool:
        """Return True if a thread other than the caller's runs or waits for a processor."""
        own = threading.get_native_id()
        return any(_state(text) == "R" for thread, text in self._read("stat") if thread != own)

    def names(self) -> dict[int, str]:
        """Return the kernel's names of the threads, of 15 characters at most, by thread id."""
        return {thread: text.strip() for thread, text in self._read("comm")}

    def load(self) -> Load:
        """Return the present load of the machine."""
        running = Path("/proc/loadavg").read_text().split()[3].partition("/")[0]
        return Load(int(running), len(os.sched_getaffinity(0)))

    def _read(self, file: str) -> Iterator[tuple[int, str]]:
        with suppress(OSError):  # the process has ended
            for thread in self._folder.iterdir():
                with suppress(OSError):  # the thread has
                    yield int(thread.name), (thread / file).read_text()


def _times_of(text: str) -> ThreadTimes:
    ran, waited, *_ = text.split()
    return ThreadTimes(int(ran) * 1e-9, int(waited) * 1e-9)


def _state(text: str) -> str:
    """Return the state in a line of `proc_pid_stat(5)`; the name before it may hold any character."""
    return text.rpartition(")")[2].split()[0]
