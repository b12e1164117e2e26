"""One transition at a time, for the shortest paths that findings show."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from pcmrs.fsm.verify._encoding import Codes, Encoding, Mask

Allowed = dict[int, tuple[int, ...]]
"""Digits, and the values that each may have."""

Guard = tuple[tuple[int, tuple[int, ...]], ...]
"""The same in the order in which it is checked."""


@dataclass(frozen=True, slots=True)
class Transition:
    """Effect of one ending of a command wherever its guard holds.

    Attributes:
        command: ``branch.operation`` or ``branch.operation:outcome``.
        guard: Digits it depends on, the most selective first; a digit that it changes has one value.
        targets: Values of the digits that it changes.
        shift: Number that it adds to the code.
    """

    command: str
    guard: Guard
    targets: dict[int, int]
    shift: int

    @classmethod
    def of(cls, encoding: Encoding, command: str, guard: Allowed, targets: dict[int, int]) -> Transition:
        """Return a transition; a digit with a target must have one value in the guard.

        Args:
            encoding: Encoding of the codes.
            command: ``branch.operation`` or ``branch.operation:outcome``.
            guard: Digits that it depends on, with the values that each may have.
            targets: Values of the digits that it sets.
        """
        moved = {digit: value for digit, value in targets.items() if guard[digit] != (value,)}
        shift = sum((value - guard[digit][0]) * encoding.weights[digit] for digit, value in moved.items())
        selective = sorted(guard.items(), key=lambda part: len(part[1]) / encoding.sizes[part[0]])
        return cls(command, tuple(selective), moved, shift)

    def holds(self, encoding: Encoding, codes: Codes) -> Mask:
        """Return a mask of the codes from which the transition can be taken, shape (n,).

        Args:
            encoding: Encoding of the codes.
            codes: Codes, shape (n,).
        """
        found = np.ones(len(codes), dtype=np.bool_)
        for digit, allowed in self.guard:
            found &= np.isin(codes // encoding.weights[digit] % encoding.sizes[digit], allowed)
        return found


class Paths:
    """Shortest paths to the codes that a search has found.

    The guards of the reversed transitions are a decision tree: a condition that many share is evaluated once.

    Args:
        encoding: Encoding of the codes.
        levels: Codes by the length of the shortest path from the initial ones, each level sorted.
        transitions: All transitions that the search has taken.
    """

    def __init__(self, encoding: Encoding, levels: list[Codes], transitions: Iterable[Transition]) -> None:
        self._encoding = encoding
        self._levels = levels
        by_guard: dict[Guard, list[Transition]] = {}
        for transition in transitions:
            if transition.shift:
                by_guard.setdefault(_reversed(transition), []).append(transition)
        self._root = _Node(by_guard.items(), 0)

    def path_to(self, code: int) -> tuple[str, ...]:
        """Return the commands of a shortest path to a code."""
        length = next(n for n, level in enumerate(self._levels) if _contains(level, code))
        commands: list[str] = []
        for level in reversed(self._levels[:length]):
            leading = (
                each for each in self._root.matching(self._encoding, code) if _contains(level, code - each.shift)
            )
            last = next(leading)
            commands.append(last.command)
            code -= last.shift
        return tuple(reversed(commands))


class _Node:
    """A question of the tree.

    Args:
        groups: Transitions by their reversed guards; those with an empty rest of the guard match here.
        depth: Number of parts of each guard that are known to hold here.
    """

    def __init__(self, groups: Iterable[tuple[Guard, list[Transition]]], depth: int) -> None:
        self._found: list[Transition] = []
        below: dict[tuple[int, tuple[int, ...]], list[tuple[Guard, list[Transition]]]] = {}
        for group in groups:
            guard, transitions = group
            if len(guard) == depth:
                self._found = transitions
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

    def matching(self, encoding: Encoding, code: int) -> Iterator[Transition]:
        """Return the transitions whose reversed guard holds for a code."""
        yield from self._found
        for digit, by_value in self._exactly.items():
            following = by_value.get(encoding.digit(code, digit))
            if following is not None:
                yield from following.matching(encoding, code)
        for digit, allowed, following in self._one_of:
            if encoding.digit(code, digit) in allowed:
                yield from following.matching(encoding, code)


def _reversed(transition: Transition) -> Guard:
    """Return what holds for a code after the transition."""
    targets = transition.targets
    return tuple((digit, (targets[digit],) if digit in targets else allowed) for digit, allowed in transition.guard)


def _contains(level: Codes, code: int) -> bool:
    place = int(np.searchsorted(level, code))
    return place < len(level) and int(level[place]) == code
