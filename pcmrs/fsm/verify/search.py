"""Breadth-first search in arrays, and the shortest way to what it has found."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.verify.encoding import Batch, Codes, Encoding
from pcmrs.fsm.verify.transition import Choices, Transition
from pcmrs.fsm.verify.visited import Visited, visited

BATCH = 2**17
"""So many codes are looked at together: their digits take a few MB."""

Progress = Callable[[int, int], None]
"""Called with how many joint states have been looked at, and how many are known."""


Key = TypeVar("Key", bound=Hashable)


class TooManyError(Exception):
    """A search would go beyond its limit; never leaves the package."""


class Reached:
    """What can be reached, in the order of the length of the shortest way there.

    Attributes:
        encoding: Of the codes.
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
        """All of them, nearest first."""
        return _batches(self.encoding, np.concatenate(self.levels))

    def first(self, wanted: Callable[[Batch], NDArray[np.bool_]]) -> int | None:
        """One of the nearest that is wanted, if any is."""
        return self.firsts({None: wanted}).get(None)

    def firsts(self, wanted: Mapping[Key, Callable[[Batch], NDArray[np.bool_]]]) -> dict[Key, int]:
        """One of the nearest of each kind that is wanted, found in one pass; of some kinds there may be none."""
        found: dict[Key, int] = {}
        for batch in self.batches():
            for key in wanted.keys() - found.keys():
                codes = batch.codes[wanted[key](batch)]
                if len(codes):
                    found[key] = int(codes[0])
            if len(found) == len(wanted):
                break
        return found

    def which(self, wanted: Callable[[Batch], NDArray[np.bool_]]) -> Codes:
        """All that are wanted."""
        return np.concatenate([batch.codes[wanted(batch)] for batch in self.batches()])

    def way_to(self, code: int, transitions: Iterable[Transition]) -> tuple[str, ...]:
        """The commands of a shortest way from the initial code."""
        back = Choices(transition.backward() for transition in transitions if transition.shift)
        length = next(n for n, level in enumerate(self.levels) if _contains(level, code))
        commands: list[str] = []
        for level in reversed(self.levels[:length]):
            command, code = next(_predecessors(self.encoding, code, back, level))
            commands.append(command)
        return tuple(reversed(commands))


def search(
    encoding: Encoding,
    initial: Codes,
    following: Callable[[Batch], Iterable[Codes]],
    *,
    limit: int,
    progress: Progress | None = None,
    within: Visited | None = None,
) -> Reached:
    """Finds everything that can be reached.

    Args:
        encoding: Of the codes.
        initial: Where it begins.
        following: Successors of the codes in a batch, in arrays that hold no code twice.
        limit: How many may be found.
        progress: Told now and then.
        within: Only these are entered.

    Raises:
        TooManyError: There are more than `limit`.
    """
    known = visited(encoding.combinations)
    levels = [np.sort(known.add(initial))]
    looked_at, found = 0, len(initial)
    while len(levels[-1]):
        new: list[Codes] = []
        for batch in _batches(encoding, levels[-1]):
            for codes in following(batch):
                entered = known.add(codes if within is None else codes[within.has(codes)])
                found += len(entered)
                new.append(entered)
            if found > limit:
                text = f"There are more than {limit} joint states, which is the limit: "
                raise TooManyError(f"{text}make it fewer branches or states, or raise the limit.")
            looked_at += len(batch.codes)
            if progress is not None:
                progress(looked_at, found)
        levels.append(np.sort(np.concatenate(new)) if new else np.empty(0, dtype=np.int64))
    return Reached(encoding, levels[:-1], known)


def leading_to(
    reached: Reached, goal: Codes, transitions: Iterable[Transition], *, progress: Progress | None = None
) -> Visited:
    """All that is reached and from which one of `goal` can be reached."""
    back = Choices(transition.backward() for transition in transitions if transition.shift)
    limit = len(reached)
    return search(
        reached.encoding, goal, back.successors, limit=limit, progress=progress, within=reached.visited
    ).visited


def _batches(encoding: Encoding, codes: Codes) -> Iterator[Batch]:
    for start in range(0, len(codes), BATCH):
        yield Batch(encoding, codes[start : start + BATCH])


def _contains(level: Codes, code: int) -> bool:
    place = int(np.searchsorted(level, code))
    return place < len(level) and int(level[place]) == code


def _predecessors(encoding: Encoding, code: int, back: Choices, level: Codes) -> Iterator[tuple[str, int]]:
    batch = Batch(encoding, np.array([code], dtype=np.int64))
    for transitions, _ in back.enabled(batch):
        for transition in transitions:
            if _contains(level, code + transition.shift):
                yield transition.command, code + transition.shift
