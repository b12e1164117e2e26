"""Decision trees of all operations, grown on demand and evaluated together for many joint states."""

from __future__ import annotations

from array import array
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.verify._encoding import Batch, Encoding
from pcmrs.fsm.verify.decision import DecisionCase

DecisionNumbers = NDArray[np.int64]
"""Numbers of the decisions that are taken, shape (operations, n)."""

Decide = Callable[[int, int], DecisionCase]
"""Makes the decision about an operation, by its number, in a joint state, by its code."""

UNKNOWN = 0
"""In place of a child: what is decided there has not been asked."""


class Forest:
    """A decision tree for each operation.

    A closure reads few branches, and which it reads next depends on those it has read: that is a decision tree. Each of
    its leaves is worked out once, however many joint states lead there. All trees are evaluated in step, one question
    for all operations and joint states at a time, so that there are as many calls of numpy as the deepest tree has
    levels.

    Args:
        encoding: Encoding of the joint states.
        own: Digit of the branch of each operation, which its decisions depend on first.
        decide: Makes a decision.

    Attributes:
        learned: Each operation and decision that has occurred, by the number of the decision.
        paths: Values of the digits that lead to each decision: they sort as in a walk through the tree.
    """

    def __init__(self, encoding: Encoding, own: list[int], decide: Decide) -> None:
        self.learned: list[tuple[int, DecisionCase]] = []
        self.paths: list[list[int]] = []
        self._encoding = encoding
        self._decide = decide
        # Node 0 is no node. A child is a node, or ~number of a decision, or UNKNOWN.
        self._digit = array("q", [0])
        self._first = array("q", [0])
        self._child = array("q", [UNKNOWN])
        self._roots = [self._node(digit) for digit in own]

    def evaluate(self, batch: Batch) -> DecisionNumbers:
        """Return the decision about every operation in every joint state, shape (operations, n).

        Args:
            batch: The joint states, which may have further digits.
        """
        number = len(batch.codes)
        found = np.empty(len(self._roots) * number, dtype=np.int64)
        open_ = np.arange(len(found))
        node, row = np.repeat(self._roots, number), np.tile(np.arange(number), len(self._roots))
        while len(open_):
            slot = _view(self._first)[node] + batch.digits[_view(self._digit)[node], row]
            node = _view(self._child)[slot]
            if not node.all():
                missing = np.flatnonzero(node == UNKNOWN)
                # One joint state for each missing child; others there may need another decision, but further down.
                _, some = np.unique(slot[missing], return_index=True)
                for place in missing[some].tolist():
                    self._learn(int(open_[place]) // number, int(batch.codes[row[place]]))
                node = _view(self._child)[slot]
            decided = node < 0
            found[open_[decided]] = ~node[decided]
            open_, node, row = open_[~decided], node[~decided], row[~decided]
        return found.reshape(len(self._roots), number)

    def _learn(self, operation: int, code: int) -> None:
        """Add the decision that is taken in a joint state, and the questions that lead to it."""
        decision = self._decide(operation, code)
        node = self._roots[operation]
        slot = 0
        path: list[int] = []
        for name, state in decision.seen.items():
            position = self._encoding.position[name]
            if path and self._encoding.sizes[position] == 1:
                continue
            if path:
                if self._child[slot] == UNKNOWN:
                    self._child[slot] = self._node(position)
                node = self._child[slot]
            if node < 0 or self._digit[node] != position:
                raise TypeError("a closure is not a function of the joint state")
            path.append(self._encoding.value(name, state))
            slot = self._first[node] + path[-1]
        self._child[slot] = ~len(self.learned)
        self.learned.append((operation, decision))
        self.paths.append(path)

    def _node(self, position: int) -> int:
        """Return a new node that asks for a digit."""
        self._digit.append(position)
        self._first.append(len(self._child))
        self._child.extend([UNKNOWN] * self._encoding.sizes[position])
        return len(self._digit) - 1


def _view(numbers: array[int]) -> NDArray[np.int64]:
    """Return an array that shares the memory of another; it must be dropped before that grows."""
    return np.frombuffer(numbers, dtype=np.int64)
