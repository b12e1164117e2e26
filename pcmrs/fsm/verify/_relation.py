"""Transition relation: the numbers that each decision about an operation may add to the code of a joint state."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pcmrs.fsm.verify._encoding import Codes, Mask, Rows
from pcmrs.fsm.verify._forest import DecisionNumbers

Edges = tuple[Rows, Codes]
"""Transitions from a batch: the row that each leaves and the code that it leads to, shape (transitions,) each."""


class Relation:
    """Some of the transitions of a workflow.

    Args:
        counts: Number of transitions for each decision.
        shifts: Number that each transition adds to the code, those of the first decision first.
    """

    def __init__(self, counts: NDArray[np.integer[Any]], shifts: Codes) -> None:
        self.counts = counts
        self._shifts = shifts
        self._first = np.cumsum(counts) - counts

    def mark(self, decisions: DecisionNumbers) -> Mask:
        """Return a mask of the joint states in which any of the transitions can be taken."""
        found: Mask = np.logical_or.reduce((self.counts > 0)[decisions], axis=0)
        return found

    def edges(self, codes: Codes, decisions: DecisionNumbers, where: NDArray[np.bool_] | None = None) -> Edges:
        """Return the transitions from some codes.

        Args:
            codes: Codes, shape (n,).
            decisions: Decisions there, shape (operations, n).
            where: Mask of the decisions to look at; all by default.
        """
        counts = self.counts[decisions] if where is None else self.counts[decisions] * where
        operation, row = np.nonzero(counts)
        counts = counts[operation, row]
        end = np.cumsum(counts)
        # The transitions of a decision are stored side by side.
        start = self._first[decisions[operation, row]] - (end - counts)
        transition = np.arange(counts.sum()) + np.repeat(start, counts)
        rows = np.repeat(row, counts)
        return rows, codes[rows] + self._shifts[transition]
