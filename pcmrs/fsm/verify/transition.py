"""One transition between joint states, forwards and backwards."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.verify.encoding import Batch, Codes, Encoding, Rows

Guard = tuple[tuple[int, tuple[int, ...]], ...]
"""Digits, and the values that each may have."""


@dataclass(frozen=True, slots=True)
class Transition:
    """Effect of one ending of a command wherever its guard holds.

    Attributes:
        command: ``branch.operation`` or ``branch.operation:outcome``.
        branch: Branch of the operation.
        operation: Name of the operation.
        intended: A user may ask for it, and it ends as declared: no fault, doubt or device event is involved.
        guard: Digits it depends on, the most selective first; a digit that it changes has
            one value.
        targets: Values of the digits that it changes.
        shift: Number that it adds to the code.
    """

    command: str
    branch: str
    operation: str
    intended: bool
    guard: Guard
    targets: dict[int, int]
    shift: int

    @classmethod
    def of(
        cls,
        encoding: Encoding,
        command: str,
        requested: tuple[str, str],
        intended: bool,
        guard: dict[int, tuple[int, ...]],
        targets: dict[int, int],
    ) -> Transition:
        """Return a transition; a digit with a target must have one value in the guard.

        Args:
            encoding: Encoding of the codes.
            command: ``branch.operation`` or ``branch.operation:outcome``.
            requested: Branch and operation that were requested.
            intended: A user may ask for it, and it ends as declared.
            guard: Digits that it depends on, with the values that each may have.
            targets: Values of the digits that it sets.
        """
        moved = {digit: value for digit, value in targets.items() if guard[digit] != (value,)}
        shift = sum((value - guard[digit][0]) * encoding.weights[digit] for digit, value in moved.items())
        return cls(command, *requested, intended, most_selective_first(encoding, guard), moved, shift)

    def backward(self) -> Transition:
        """Return the reverse of the transition."""
        guard = {digit: (self.targets[digit],) if digit in self.targets else allowed for digit, allowed in self.guard}
        before = {digit: allowed[0] for digit, allowed in self.guard if digit in self.targets}
        return replace(self, guard=tuple(guard.items()), targets=before, shift=-self.shift)


def most_selective_first(encoding: Encoding, guard: dict[int, tuple[int, ...]]) -> Guard:
    """Return a guard in the order in which most rows are dropped by the first question.

    Args:
        encoding: Encoding of the codes.
        guard: Digits, with the values that each may have.
    """
    return tuple(sorted(guard.items(), key=lambda part: len(part[1]) / encoding.sizes[part[0]]))


class TransitionTree:
    """Transitions as a decision tree of their guards: a condition that many share is evaluated once.

    Args:
        transitions: Transitions of the tree.
    """

    def __init__(self, transitions: Iterable[Transition]) -> None:
        by_guard: dict[Guard, list[Transition]] = {}
        for transition in transitions:
            by_guard.setdefault(transition.guard, []).append(transition)
        self._root = _Node(by_guard.items(), 0)

    def enabled(self, batch: Batch) -> Iterator[tuple[list[Transition], Rows]]:
        """Return groups of transitions with the same guard, and the rows where it holds; no row twice, no empty group.

        Args:
            batch: Some codes.
        """
        return self._root.enabled(batch, None)

    def mark(self, batch: Batch) -> NDArray[np.bool_]:
        """Return a mask of the rows where any of the transitions can be taken; shape (n,)."""
        found = np.zeros(len(batch.codes), dtype=np.bool_)
        for _, rows in self.enabled(batch):
            found[rows] = True
        return found

    def successors(self, batch: Batch) -> Iterator[Codes]:
        """Return the codes that the transitions lead to from a batch; no array holds a code twice."""
        for transitions, rows in self.enabled(batch):
            codes = batch.codes[rows]
            for shift in {transition.shift for transition in transitions} - {0}:
                yield codes + shift


class _Node:
    """A question of the tree.

    Args:
        groups: Transitions by their guards; those with an empty rest of the guard are taken here.
        depth: Number of parts of each guard that are known to hold here.
    """

    def __init__(self, groups: Iterable[tuple[Guard, list[Transition]]], depth: int) -> None:
        self.taken: list[Transition] = []
        below: dict[tuple[int, tuple[int, ...]], list[tuple[Guard, list[Transition]]]] = {}
        for group in groups:
            guard, transitions = group
            if len(guard) == depth:
                self.taken = transitions
            else:
                below.setdefault(guard[depth], []).append(group)
        self._one_of: list[tuple[int, tuple[int, ...], _Node]] = []
        self._exactly: dict[int, dict[int, _Node]] = {}
        for (digit, allowed), those in below.items():
            following = _Node(those, depth + 1)
            if len(allowed) == 1:
                self._exactly.setdefault(digit, {})[allowed[0]] = following
            else:
                self._one_of.append((digit, allowed, following))

    def enabled(self, batch: Batch, rows: Rows | None) -> Iterator[tuple[list[Transition], Rows]]:
        """See `TransitionTree.enabled`; `rows` are those to look at, None for all."""
        if self.taken:
            yield self.taken, np.arange(len(batch.codes)) if rows is None else rows
        for digit, by_value in self._exactly.items():
            for value, part in batch.split(digit, rows):
                if value in by_value and len(part):
                    yield from by_value[value].enabled(batch, part)
        for digit, allowed, following in self._one_of:
            part = batch.rows_among(digit, allowed, rows)
            if len(part):
                yield from following.enabled(batch, part)
