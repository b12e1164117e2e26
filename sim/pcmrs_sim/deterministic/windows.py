"""Windows: the moments in which work is in other hands, how long each lasts, and who waits to act inside one.

A request is in other hands between the loop and its sender's thread, a row between the loop and the disk, a reply
between the device and the one who asked. In a real cell each takes as long as the scheduler likes. Here every one has
a name, such as ``send:robot.follow`` or ``write:outcome:placement.back_off``; it lasts as long as the seed draws, or as
a script says, and a script can act inside it.
"""

from __future__ import annotations

import asyncio
import random
from collections import Counter
from fnmatch import fnmatchcase
from typing import NamedTuple

LONGEST = 0.5
"""A hand-over, a callback or a write takes this at most, s."""


class _Wait(NamedTuple):
    """Somebody who acts in the next window of a name."""

    pattern: str
    held: float
    opened: asyncio.Future[None]


class Windows:
    """All windows of one cell.

    Args:
        loop: In whose time they last.
        seed: Of how long they last.
        share: Part of the windows that take time by themselves.

    Attributes:
        share: See above.
        opened: Name to how many windows there were.
        slow: How many of them took time.
    """

    def __init__(self, loop: asyncio.AbstractEventLoop, seed: int, share: float = 0.0) -> None:
        self.share = share
        self.opened: Counter[str] = Counter()
        self.slow = 0
        self._loop = loop
        self._seed = seed
        self._waits: list[_Wait] = []

    def open(self, name: str) -> float:
        """Opens a window; returns how long it lasts, s."""
        self.opened[name] += 1
        lasts = self._drawn(name) if self.share else 0.0
        for wait in self._waits:
            if not wait.opened.done() and fnmatchcase(name, wait.pattern):
                lasts = max(lasts, wait.held)
                wait.opened.set_result(None)
        self.slow += lasts > 0.0
        return lasts

    async def reached(self, pattern: str, held: float, patience: float) -> bool:
        """Returns when the next window of a name opens, which then lasts `held` s.

        Args:
            pattern: Of names, as in a shell.
            held: At least, s.
            patience: Returns after this anyhow, s.

        Returns:
            Whether it has opened.
        """
        wait = _Wait(pattern, held, self._loop.create_future())
        self._waits.append(wait)
        try:
            await asyncio.wait([wait.opened], timeout=patience)
        finally:
            self._waits.remove(wait)
        return wait.opened.done()

    def _drawn(self, name: str) -> float:
        """By seed, name and number: a window lasts as long as before when an act elsewhere is left out."""
        draw = random.Random(f"{self._seed} {name} {self.opened[name]}")
        return draw.uniform(0.0, LONGEST) if draw.random() < self.share else 0.0
