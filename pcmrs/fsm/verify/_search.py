"""Breadth-first search in arrays, forwards and backwards, and the budget of all searches."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np

from pcmrs.fsm.verify._encoding import Batch, Codes, Encoding, Mask, Rows
from pcmrs.fsm.verify._relation import Edges

MOMENTS_PER_STATE = 32
"""Moments that all searches may examine together, for each joint state of the limit."""

MIN_BUDGET = 1_000_000
"""Budget of moments that does not depend on the limit of joint states."""


class SearchBudget:
    """Budget of moments that the searches of one verification may examine together.

    Args:
        limit: Largest number of joint states.
        progress: Called regularly with the numbers of moments that have been examined and that are known.
        done: Number of joint states that were examined before.
    """

    def __init__(self, limit: int, progress: Progress | None = None, done: int = 0) -> None:
        self._limit = max(MIN_BUDGET, MOMENTS_PER_STATE * limit)
        self._left = self._limit
        self._progress = progress
        self._done = done

    def spend(self, moments: int) -> None:
        """Subtract so many examined moments, or what takes as long.

        Raises:
            SearchLimitError: The budget is exhausted.
        """
        self._check(moments)
        self._left -= moments
        self._done += moments

    def follow(self, looked_at: int, known: int) -> None:
        """Report the progress of a search whose work is not yet spent.

        Args:
            looked_at: Moments that it has examined.
            known: Moments that it has found.

        Raises:
            SearchLimitError: The search goes beyond the budget.
        """
        self._check(known)
        if self._progress is not None:
            self._progress(self._done + looked_at, self._done + known)

    def _check(self, moments: int) -> None:
        if moments > self._left:
            text = f"The properties watch too many joint states and running operations: over {self._limit} moments. "
            raise SearchLimitError(f"{text}Reduce the properties of `running`, `leads_to` or Stop, or raise the limit.")


MAX_BITMAP = 2**27
"""Number of combinations up to which a set has a byte for each."""


class Visited(Protocol):
    """A set of codes that is fast to query and to extend."""

    def add(self, codes: Codes) -> Codes:
        """Add codes and return those that are new, sorted, none of them twice."""
        ...

    def has(self, codes: Codes) -> Mask:
        """Return a mask of the codes that are in the set, shape (n,)."""
        ...


def visited(combinations: int) -> Visited:
    """Return an empty set for codes below `combinations`."""
    return _Bitmap(combinations) if combinations <= MAX_BITMAP else _Runs()


class _Bitmap:
    def __init__(self, combinations: int) -> None:
        self._bytes = np.zeros(combinations, dtype=np.bool_)

    def add(self, codes: Codes) -> Codes:
        new: Codes = np.unique(codes[~self._bytes[codes]])
        self._bytes[new] = True
        return new

    def has(self, codes: Codes) -> Mask:
        return self._bytes[codes]


class _Runs:
    """Sorted arrays, each at least twice as long as the next, so that there are few of them."""

    def __init__(self) -> None:
        self._runs: list[Codes] = []

    def add(self, codes: Codes) -> Codes:
        new: Codes = np.unique(codes[~self.has(codes)])
        if len(new):
            self._runs.append(new)
        # Merging runs of similar length keeps their number logarithmic, and the cost of each code, too.
        while len(self._runs) > 1 and len(self._runs[-2]) < 2 * len(self._runs[-1]):
            last = self._runs.pop()
            self._runs[-1] = np.sort(np.concatenate([self._runs[-1], last]), kind="stable")
        return new

    def has(self, codes: Codes) -> Mask:
        found = np.zeros(len(codes), dtype=np.bool_)
        for run in self._runs:
            place = np.minimum(np.searchsorted(run, codes), len(run) - 1)
            found |= run[place] == codes
        return found


BATCH = 2**12
"""Codes that are examined together: their transitions take some MB."""

Progress = Callable[[int, int], None]
"""Called with the numbers of joint states that have been examined and that are known."""


Key = TypeVar("Key", bound=Hashable)


class SearchLimitError(Exception):
    """A search would go beyond its limit; never leaves the package."""


class Reached:
    """All codes that can be reached, by the length of the shortest path.

    Args:
        encoding: Encoding of the codes.
        levels: Codes by the length of the shortest path from the initial one, each level sorted.
        known: All of them.

    Attributes:
        encoding: Encoding of the codes.
        levels: Codes by the length of the shortest way from the initial one, each level sorted.
        visited: All of them.
    """

    def __init__(self, encoding: Encoding, levels: list[Codes], known: Visited) -> None:
        self.encoding = encoding
        self.levels = levels
        self.visited = known

    def __len__(self) -> int:
        return sum(map(len, self.levels))

    def batches(self) -> Iterator[Batch]:
        """Return all of them, nearest first."""
        # Most workflows have a single batch: what is worked out about it then serves all checks.
        return iter([self._single]) if len(self) <= BATCH else _batches(self.encoding, np.concatenate(self.levels))

    @cached_property
    def _single(self) -> Batch:
        return Batch(self.encoding, np.concatenate(self.levels))

    def first(self, wanted: Callable[[Batch], Mask]) -> int | None:
        """Return one of the nearest codes that are wanted, or None."""
        return self.firsts({None: wanted}).get(None)

    def firsts(self, wanted: Mapping[Key, Callable[[Batch], Mask]]) -> dict[Key, int]:
        """Return one of the nearest codes of each kind, found in one pass; kinds without any are left out."""
        found: dict[Key, int] = {}
        for batch in self.batches():
            for key in wanted.keys() - found.keys():
                codes = batch.codes[wanted[key](batch)]
                if len(codes):
                    found[key] = int(codes[0])
            if len(found) == len(wanted):
                break
        return found

    def which(self, wanted: Callable[[Batch], Mask]) -> Codes:
        """Return all codes that are wanted."""
        return np.concatenate([batch.codes[wanted(batch)] for batch in self.batches()])


def search(
    encoding: Encoding,
    initial: Codes,
    following: Callable[[Batch], Codes],
    *,
    limit: int,
    progress: Progress | None = None,
    within: Visited | None = None,
) -> Reached:
    """Find all codes that can be reached.

    Args:
        encoding: Encoding of the codes.
        initial: Codes to start from.
        following: Returns the successors of the codes in a batch.
        limit: Largest number of codes.
        progress: Called regularly with the numbers of codes that have been examined and that are known.
        within: Set that the search may not leave; None for no limit.

    Raises:
        SearchLimitError: There are more than `limit`.
    """
    known = visited(encoding.combinations)
    levels = [known.add(initial)]
    looked_at, found = 0, len(levels[0])
    while len(levels[-1]):
        new: list[Codes] = []
        for batch in _batches(encoding, levels[-1]):
            codes = following(batch)
            new.append(known.add(codes if within is None else codes[within.has(codes)]))
            found += len(new[-1])
            # After each batch, not each level: one level alone may exceed the memory.
            if found > limit:
                text = f"There are more than {limit} joint states, which is the limit: "
                raise SearchLimitError(f"{text}reduce the branches or states, or raise the limit.")
            looked_at += len(batch.codes)
            if progress is not None:
                progress(looked_at, found)
        levels.append(np.sort(np.concatenate(new)))
    return Reached(encoding, levels[:-1], known)


def states_leading_to(
    reached: Reached, goal: Codes, leaving: Callable[[Batch], Edges], *, progress: Progress | None = None
) -> Visited:
    """Return all reached codes from which one of `goal` can be reached.

    Args:
        reached: Codes of an earlier search.
        goal: Codes to reach.
        leaving: Returns the transitions that may be taken from the codes in a batch.
        progress: Called regularly with the numbers of codes that have been examined and that are known.
    """
    open_ = visited(reached.encoding.combinations)
    open_.add(goal)
    looked_at, grown = 0, True
    # Transitions are not stored, as they may exceed the memory: each pass works them out again. Mostly, one is enough.
    while grown:
        grown = False
        waiting = [*reached.batches()]
        while waiting:
            batch = waiting.pop()  # farthest first: most transitions lead to a near code, or one level on
            if not open_.has(batch.codes).all():
                grown |= _open_up(batch, open_, *leaving(batch))
            looked_at = min(looked_at + len(batch.codes), len(reached))
            if progress is not None:
                progress(looked_at, len(reached))
    return open_


def _open_up(batch: Batch, open_: Visited, rows: Rows, codes: Codes) -> bool:
    """Add the codes of a batch from which transitions lead to open ones; return false if there are none."""
    grown = False
    while True:
        closed = ~open_.has(batch.codes)[rows]
        rows, codes = rows[closed], codes[closed]
        if not len(open_.add(batch.codes[rows[open_.has(codes)]])):
            return grown
        grown = True


def _batches(encoding: Encoding, codes: Codes) -> Iterator[Batch]:
    for start in range(0, len(codes), BATCH):
        yield Batch(encoding, codes[start : start + BATCH])
