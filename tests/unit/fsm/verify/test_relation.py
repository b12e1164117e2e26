"""Transition relations against the shifts of every decision one at a time."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm.verify._relation import Relation

SHIFTS = st.lists(st.lists(st.integers(-50, 50), max_size=3), max_size=5).map(lambda each: [[], *each])
"""For each decision; the first one allows nothing."""


@given(SHIFTS, st.data())
def test_edges_are_all_shifts_of_the_decisions_in_each_row(shifts: list[list[int]], data: st.DataObject) -> None:
    operations, rows = data.draw(st.integers(1, 3)), data.draw(st.integers(1, 5))
    some = st.lists(st.integers(0, len(shifts) - 1), min_size=operations * rows, max_size=operations * rows)
    decisions = np.array(data.draw(some), dtype=np.int64).reshape(operations, rows)
    size = operations * rows
    where = np.array(data.draw(st.lists(st.booleans(), min_size=size, max_size=size)), dtype=np.bool_)
    where = where.reshape(operations, rows)
    codes = np.arange(rows) * 1000
    counts, flat = np.array([len(each) for each in shifts]), np.array([shift for each in shifts for shift in each])
    relation = Relation(counts, flat.astype(np.int64))
    for chosen in (None, where):
        expected = [
            (row, row * 1000 + shift)
            for operation, row in np.ndindex(decisions.shape)
            if chosen is None or chosen[operation, row]
            for shift in shifts[decisions[operation, row]]
        ]
        found = relation.edges(codes, decisions, chosen)
        assert sorted(zip(*(each.tolist() for each in found), strict=True)) == sorted(expected)
    marked = [any(shifts[decision] for decision in column) for column in decisions.T]
    assert relation.mark(decisions).tolist() == marked
