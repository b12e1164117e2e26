"""Scheduling of the threads of a process by Linux: how long each one ran and waited for a processor."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import NamedTuple


class ThreadTimes(NamedTuple):
    """Scheduling times of one thread since its start.

    Attributes:
        ran: Time on a processor, s.
        waited: Time in which it was ready to run and waited for a processor, s.
    """

    ran: float
    waited: float


LOAD_FILE = "/proc/loadavg"
_NONE = ThreadTimes(0.0, 0.0)
_SMALL = 4096
"""Size above which a file of `proc(5)` may be read in parts, bytes."""


class Load(NamedTuple):
    """Load of the machine.

    Attributes:
        running: Number of threads that run or wait for a processor; None if this process may not read it.
        processors: Number of processors that this process may use.
    """

    running: int | None
    processors: int

    @property
    def is_too_high(self) -> bool:
        """True if threads are known to wait for a processor."""
        return self.running is not None and self.running > self.processors

    def __str__(self) -> str:
        if self.running is None:
            return "the load of the machine is not known"
        many = f"{self.processors} processor" + "s" * (self.processors > 1)
        return f"{self.running} threads want to run on {many}"


class Threads:
    """The threads of one process.

    Args:
        pid: Id of the process; None for this one.
    """

    def __init__(self, pid: int | None = None) -> None:
        self._folder = f"/proc/{pid or os.getpid()}/task"
        self._before: dict[int, ThreadTimes] | None = None

    def ids(self) -> list[int]:
        """Return the ids of the threads; empty if the process has ended."""
        try:
            return list(map(int, os.listdir(self._folder)))  # noqa: PTH208  # the heart calls it often
        except OSError:
            return []

    def times(self, which: Callable[[int], bool] = lambda _: True) -> dict[int, ThreadTimes]:
        """Return the times by thread id; empty if the process has ended or the kernel does not count them.

        Args:
            which: Returns True for the id of a thread whose times are wanted.
        """
        return {thread: _times_of(text) for thread, text in self._read("schedstat", which)}

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
        """Return the present load of the machine, as far as this process may know it."""
        try:
            running = int(_read_small(LOAD_FILE).split()[3].partition("/")[0])
        except OSError:  # a sandbox may hide it, such as ProcSubset=pid of systemd
            running = None
        return Load(running, len(os.sched_getaffinity(0)))

    def _read(self, file: str, which: Callable[[int], bool] = lambda _: True) -> Iterator[tuple[int, str]]:
        for thread in filter(which, self.ids()):
            with suppress(OSError):  # the thread has ended
                yield thread, _read_small(f"{self._folder}/{thread}/{file}")


def descendants(pid: int) -> list[int]:
    """Return the ids of the child processes that the main thread of a process has started, and of theirs.

    Args:
        pid: Id of the process; the list is empty if it has ended.
    """
    try:
        children = list(map(int, _read_small(f"/proc/{pid}/task/{pid}/children").split()))
    except OSError:
        return []
    return children + [below for child in children for below in descendants(child)]


def _read_small(path: str) -> str:
    """Return the content of a small file of `proc(5)`; `Path.read_text` takes four times as long."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        return os.read(descriptor, _SMALL).decode()
    finally:
        os.close(descriptor)


def _times_of(text: str) -> ThreadTimes:
    ran, waited, *_ = text.split()
    return ThreadTimes(int(ran) * 1e-9, int(waited) * 1e-9)


def _state(text: str) -> str:
    """Return the state in a line of `proc_pid_stat(5)`; the name before it may hold any character."""
    return text.rpartition(")")[2].split()[0]
