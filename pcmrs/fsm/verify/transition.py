"""One way from joint states to joint states, and the same way back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcmrs.fsm.verify.encoding import Batch, Codes, Encoding, Rows

Guard = tuple[tuple[int, tuple[int, ...]], ...]
"""Digits, and the values that each may have."""


@dataclass(frozen=True, slots=True)
class Transition:
    """What one ending of a command does wherever its guard holds.

    Attributes:
        command: ``branch.operation`` or ``branch.operation:outcome``.
        branch: The branch asked.
        operation: The operation asked for.
        guard: Digits it depends on, the one that lets the fewest through first; of a digit that it changes there is
            one value.
        targets: Values of the digits that it changes.
        shift: What it adds to the code.
    """

    command: str
    branch: str
    operation: str
    guard: Guard
    targets: dict[int, int]
    shift: int

    @classmethod
    def of(
        cls,
        encoding: Encoding,
        command: str,
        asked: tuple[str, str],
        guard: dict[int, tuple[int, ...]],
        targets: dict[int, int],
    ) -> Transition:
        """Makes one; a digit with a target must have one value in the guard."""
        moved = {digit: value for digit, value in targets.items() if guard[digit] != (value,)}
        shift = sum((value - guard[digit][0]) * encoding.weights[digit] for digit, value in moved.items())
        by_choice = sorted(guard.items(), key=lambda part: len(part[1]) / encoding.sizes[part[0]])
        return cls(command, *asked, tuple(by_choice), moved, shift)

    def backward(self) -> Transition:
        """The way back."""
        guard = {digit: (self.targets[digit],) if digit in self.targets else allowed for digit, allowed in self.guard}
        before = {digit: allowed[0] for digit, allowed in self.guard if digit in self.targets}
        return Transition(self.command, self.branch, self.operation, tuple(guard.items()), before, -self.shift)

    def rows(self, batch: Batch) -> Rows:
        """Where its guard holds."""
        (first, allowed), *others = self.guard
        if not allowed:
            return np.empty(0, dtype=np.intp)
        rows = np.concatenate([batch.where(first, value) for value in allowed])
        for digit, values in others:
            if not len(rows):
                break
            found = batch.digit(digit)[rows]
            keep = found == values[0] if len(values) == 1 else np.isin(found, values)
            rows = rows[keep]
        return rows


Grouped = Mapping[tuple[int, tuple[int, ...]], Sequence[Transition]]
"""Transitions by the first part of their guards: where that holds nowhere in a batch, none has to be looked at."""


def by_guard(transitions: Iterable[Transition]) -> Grouped:
    """The transitions, grouped."""
    groups: dict[tuple[int, tuple[int, ...]], list[Transition]] = {}
    for transition in transitions:
        groups.setdefault(transition.guard[0], []).append(transition)
    return groups


def successors(grouped: Grouped, batch: Batch) -> Iterator[Codes]:
    """Where the transitions lead from a batch; no array holds a code twice."""
    for (digit, allowed), transitions in grouped.items():
        if any(len(batch.where(digit, value)) for value in allowed):
            for transition in transitions:
                yield batch.codes[transition.rows(batch)] + transition.shift
