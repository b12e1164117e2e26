"""Transitions between codes, forwards and backwards, against the digits of every code one at a time."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm.verify.encoding import Batch, Encoding
from pcmrs.fsm.verify.transition import Transition, TransitionTree

SIZES = (3, 2, 4, 9)
ENCODING = Encoding({f"b{n}": [str(value) for value in range(size)] for n, size in enumerate(SIZES)})
CODES = range(ENCODING.combinations)


@st.composite
def transitions(draw: st.DrawFn) -> Transition:
    """Any guard; a digit that is fixed by it may be changed."""
    guard = {
        digit: tuple(draw(st.sets(st.integers(0, size - 1), min_size=1)))
        for digit, size in enumerate(SIZES)
        if draw(st.booleans())
    }
    fixed = [digit for digit, allowed in guard.items() if len(allowed) == 1]
    changed = {digit: draw(st.integers(0, SIZES[digit] - 1)) for digit in fixed if draw(st.booleans())}
    return Transition.of(ENCODING, "b.go", ("b", "go"), True, guard, changed)


def digits(code: int) -> list[int]:
    found = []
    for size in SIZES:
        code, digit = divmod(code, size)
        found.append(digit)
    return found


def possible(transition: Transition, code: int) -> bool:
    return all(digits(code)[digit] in allowed for digit, allowed in transition.guard)


def after(transition: Transition, code: int) -> int:
    ends = dict(enumerate(digits(code))) | transition.targets
    return sum(ends[digit] * int(np.prod(SIZES[:digit])) for digit in ends)


def batch() -> Batch:
    return Batch(ENCODING, np.array(CODES, dtype=np.int64))


@given(st.lists(transitions(), max_size=6))
def test_a_tree_marks_what_any_of_its_guards_allows(each: list[Transition]) -> None:
    marked = TransitionTree(each).mark(batch())
    assert marked.tolist() == [any(possible(transition, code) for transition in each) for code in CODES]


@given(st.lists(transitions(), max_size=6))
def test_successors_are_all_other_codes_that_follow(each: list[Transition]) -> None:
    found = [codes.tolist() for codes in TransitionTree(each).successors(batch())]
    assert all(len(codes) == len(set(codes)) for codes in found)
    expected = {after(t, code) for t in each for code in CODES if t.shift and possible(t, code)}
    assert {code for codes in found for code in codes} == expected


@given(transitions())
def test_backwards_leads_from_each_end_to_where_it_began(transition: Transition) -> None:
    back = transition.backward()
    begins = [code for code in CODES if possible(transition, code)]
    ends = {after(transition, code): code for code in begins}
    assert {code for code in CODES if possible(back, code)} == set(ends)
    assert all(after(back, end) == code for end, code in ends.items())
    assert all(end - code == transition.shift == -back.shift for end, code in ends.items())
