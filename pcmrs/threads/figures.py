"""Scheduling of the threads of a process, as Linux shows it: how long each ran and waited for a processor."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple


class Figures(NamedTuple):
    """Of one thread since it began.

    Attributes:
        ran: Time on a processor, s.
        waited: Time in which it could have run and no processor was free for it, s.
    """

    ran: float
    waited: float


NONE = Figures(0.0, 0.0)


class Load(NamedTuple):
    """How much the machine has to do now.

    Attributes:
        running: Threads that run or wait for a processor.
        processors: That this process may use.
    """

    running: int
    processors: int

    def __str__(self) -> str:
        many = f"{self.processors} processor" + "s" * (self.processors > 1)
        return f"{self.running} threads want to run on {many}"


class Threads:
    """The threads of one process.

    Args:
        pid: Of the process; None for this one.
    """

    def __init__(self, pid: int | None = None) -> None:
        self._folder = Path(f"/proc/{pid or os.getpid()}/task")
        self._before: dict[int, Figures] | None = None

    def figures(self) -> dict[int, Figures]:
        """Thread id to figures; empty where the process has ended or the kernel keeps none."""
        return {thread: _figures(text) for thread, text in self._read("schedstat")}

    def waited(self) -> float:
        """The longest that one of the threads has waited for a processor since the last call, in all, s; 0 at first."""
        before, self._before = self._before, self.figures()
        if before is None:
            return 0.0
        none = Figures(0.0, 0.0)
        return max(
            (each.waited - before.get(thread, none).waited for thread, each in self._before.items()), default=0.0
        )

    def pending(self) -> bool:
        """Whether a thread other than the caller's runs, or waits for a processor."""
        own = threading.get_native_id()
        return any(_state(text) == "R" for thread, text in self._read("stat") if thread != own)

    def names(self) -> dict[int, str]:
        """Thread id to the name that the kernel knows, of 15 characters at most."""
        return {thread: text.strip() for thread, text in self._read("comm")}

    def load(self) -> Load:
        """How much the machine has to do at this moment."""
        running = Path("/proc/loadavg").read_text().split()[3].partition("/")[0]
        return Load(int(running), len(os.sched_getaffinity(0)))

    def _read(self, file: str) -> Iterator[tuple[int, str]]:
        with suppress(OSError):  # the process has ended
            for thread in self._folder.iterdir():
                with suppress(OSError):  # the thread has
                    yield int(thread.name), (thread / file).read_text()


def _figures(text: str) -> Figures:
    ran, waited, *_ = text.split()
    return Figures(int(ran) * 1e-9, int(waited) * 1e-9)


def _state(text: str) -> str:
    """Of the line of `proc_pid_stat(5)`: the name before it may hold anything."""
    return text.rpartition(")")[2].split()[0]
