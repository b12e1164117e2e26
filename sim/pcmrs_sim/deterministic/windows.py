"""Windows: intervals in which work is handed over between the event loop, threads, the disk and other processes.

Examples are a request between the loop and its sender's thread, a row between the loop and the disk, and a reply
between the device and the requester. In a real cell, the scheduler decides how long each takes. Here each window has a
name, such as ``send:robot.follow`` or ``write:outcome:placement.back_off``. Its duration is drawn from the seed or set
by a script, and a script can act inside it.
"""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from collections.abc import Callable
from fnmatch import fnmatchcase
from typing import NamedTuple

LONGEST = 0.5
"""Longest drawn duration of a hand-over, a callback or a write, s."""


class _Wait(NamedTuple):
    """A script that waits for the next window of a name."""

    pattern: str
    duration: float
    opened: asyncio.Future[None]


class Windows:
    """All windows of one cell.

    Args:
        loop: Event loop in whose time they last.
        seed: Seed of their durations.
        share: Fraction of the windows that take time without a script.

    Attributes:
        share: Fraction of the windows that take time without a script. It may be changed.
        opened: Name to number of windows so far.
        slow: Number of windows so far that took time.
        on_open: Called with name and duration, s, of each window.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, seed: int, share: float = 0.0) -> None:
        self.share = share
        self.opened: Counter[str] = Counter()
        self.slow = 0
        self.on_open: Callable[[str, float], None] = lambda *_: None
        self._loop = loop
        self._seed = seed
        self._waits: list[_Wait] = []

    def open(self, name: str) -> float:
        """Open a window and return its duration, s."""
        self.opened[name] += 1
        duration = self._draw_duration(name) if self.share else 0.0
        for wait in self._waits:
            if not wait.opened.done() and fnmatchcase(name, wait.pattern):
                duration = max(duration, wait.duration)
                wait.opened.set_result(None)
        self.slow += duration > 0.0
        self.on_open(name, duration)
        return duration

    async def reached(self, pattern: str, duration: float, timeout: float) -> bool:
        """Wait until the next window of a name opens, and make it last.

        Args:
            pattern: Shell-style pattern of the name.
            duration: Shortest duration of that window, s.
            timeout: Longest wait, s.

        Returns:
            True if the window has opened, false after the timeout.
        """
        wait = _Wait(pattern, duration, self._loop.create_future())
        self._waits.append(wait)
        try:
            await asyncio.wait([wait.opened], timeout=timeout)
        finally:
            self._waits.remove(wait)
        return wait.opened.done()

    def _draw_duration(self, name: str) -> float:
        """Draw by seed, name and number, so that the duration stays if a shrunk script leaves out other acts."""
        draw = random.Random(f"{self._seed} {name} {self.opened[name]}")
        return draw.uniform(0.0, LONGEST) if draw.random() < self.share else 0.0
