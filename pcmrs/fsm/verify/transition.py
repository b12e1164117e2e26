"""One way from joint states to joint states, and the same way back."""

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
    """What one ending of a command does wherever its guard holds.

    Attributes:
        command: ``branch.operation`` or ``branch.operation:outcome``.
        branch: The branch asked.
        operation: The operation asked for.
        intended: A user may ask for it, and it ends as declared: neither a fault, nor doubt, nor a device has its part.
        guard: Digits it depends on, the one that lets the fewest through first; of a digit that it changes there is
            one value.
        targets: Values of the digits that it changes.
        shift: What it adds to the code.
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
        asked: tuple[str, str],
        intended: bool,
        guard: dict[int, tuple[int, ...]],
        targets: dict[int, int],
    ) -> Transition:
        """Make one; a digit with a target must have one value in the guard."""
        moved = {digit: value for digit, value in targets.items() if guard[digit] != (value,)}
        shift = sum((value - guard[digit][0]) * encoding.weights[digit] for digit, value in moved.items())
        by_choice = sorted(guard.items(), key=lambda part: len(part[1]) / encoding.sizes[part[0]])
        return cls(command, *asked, intended, tuple(by_choice), moved, shift)

    def backward(self) -> Transition:
        """The way back."""
        guard = {digit: (self.targets[digit],) if digit in self.targets else allowed for digit, allowed in self.guard}
        before = {digit: allowed[0] for digit, allowed in self.guard if digit in self.targets}
        return replace(self, guard=tuple(guard.items()), targets=before, shift=-self.shift)


class Choices:
    """Transitions as a tree of what their guards ask, so that what many of them ask is asked once.

    Args:
        transitions: Those with nothing left to ask are taken here.
        asked: So many parts of each guard are known to hold.
    """

    def __init__(self, transitions: Iterable[Transition], asked: int = 0) -> None:
        self.taken: list[Transition] = []
        below: dict[tuple[int, tuple[int, ...]], list[Transition]] = {}
        for transition in transitions:
            if len(transition.guard) == asked:
                self.taken.append(transition)
            else:
                below.setdefault(transition.guard[asked], []).append(transition)
        self._one_of: list[tuple[int, tuple[int, ...], Choices]] = []
        self._exactly: dict[int, dict[int, Choices]] = {}
        for (digit, allowed), those in below.items():
            following = Choices(those, asked + 1)
            if len(allowed) == 1:
                self._exactly.setdefault(digit, {})[allowed[0]] = following
            else:
                self._one_of.append((digit, allowed, following))

    def enabled(self, batch: Batch, rows: Rows | None = None) -> Iterator[tuple[list[Transition], Rows]]:
        """Transitions with the same guard, and where it holds: nowhere twice, and never nowhere at all."""
        if self.taken:
            yield self.taken, np.arange(len(batch.codes)) if rows is None else rows
        for digit, by_value in self._exactly.items():
            for value, part in batch.split(digit, rows):
                if value in by_value and len(part):
                    yield from by_value[value].enabled(batch, part)
        for digit, allowed, following in self._one_of:
            part = batch.among(digit, allowed, rows)
            if len(part):
                yield from following.enabled(batch, part)

    def mark(self, batch: Batch) -> NDArray[np.bool_]:
        """Where any of the transitions can be taken; shape (n,)."""
        found = np.zeros(len(batch.codes), dtype=np.bool_)
        for _, rows in self.enabled(batch):
            found[rows] = True
        return found

    def successors(self, batch: Batch) -> Iterator[Codes]:
        """Where the transitions lead from a batch; no array holds a code twice."""
        for transitions, rows in self.enabled(batch):
            codes = batch.codes[rows]
            for shift in {transition.shift for transition in transitions} - {0}:
                yield codes + shift
