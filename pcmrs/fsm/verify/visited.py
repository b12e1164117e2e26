"""Sets of codes that are fast to ask and to add to, a bit of memory for each."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.verify.encoding import Codes

MAX_BITMAP = 2**27
"""Up to so many combinations there is a byte for each."""


class Visited(Protocol):
    """A set of codes."""

    def add(self, codes: Codes) -> Codes:
        """Adds codes, none of them twice in the array, and returns those that are new."""
        ...

    def has(self, codes: Codes) -> NDArray[np.bool_]:
        """Which of the codes are in the set, shape (n,)."""
        ...


def visited(combinations: int) -> Visited:
    """An empty set for codes below `combinations`."""
    return _Bitmap(combinations) if combinations <= MAX_BITMAP else _Runs()


class _Bitmap:
    def __init__(self, combinations: int) -> None:
        self._bytes = np.zeros(combinations, dtype=np.bool_)

    def add(self, codes: Codes) -> Codes:
        new: Codes = codes[~self._bytes[codes]]
        self._bytes[new] = True
        return new

    def has(self, codes: Codes) -> NDArray[np.bool_]:
        return self._bytes[codes]


class _Runs:
    """Sorted arrays, each at least twice as long as the next, so that there are few of them."""

    def __init__(self) -> None:
        self._runs: list[Codes] = []

    def add(self, codes: Codes) -> Codes:
        new: Codes = codes[~self.has(codes)]
        if len(new):
            self._runs.append(np.sort(new))
        while len(self._runs) > 1 and len(self._runs[-2]) < 2 * len(self._runs[-1]):
            last = self._runs.pop()
            self._runs[-1] = np.sort(np.concatenate([self._runs[-1], last]), kind="stable")
        return new

    def has(self, codes: Codes) -> NDArray[np.bool_]:
        found = np.zeros(len(codes), dtype=np.bool_)
        for run in self._runs:
            place = np.minimum(np.searchsorted(run, codes), len(run) - 1)
            found |= run[place] == codes
        return found
