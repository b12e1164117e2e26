"""Transitions between codes, and paths of them, against the digits of every code one at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.fsm.verify._encoding import Encoding
from pcmrs.fsm.verify._transition import Paths, Transition

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
    return Transition.of(ENCODING, "b.go", guard, changed)


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


@given(transitions())
def test_a_guard_holds_where_all_its_digits_are_allowed(transition: Transition) -> None:
    marked = transition.holds(ENCODING, np.array(CODES, dtype=np.int64))
    assert marked.tolist() == [possible(transition, code) for code in CODES]
    assert all(after(transition, code) == code + transition.shift for code in CODES if possible(transition, code))


@given(st.lists(transitions(), max_size=8), st.sampled_from(CODES))
def test_paths_are_shortest_and_lead_there(unnamed: list[Transition], start: int) -> None:
    each = [replace(transition, command=str(number)) for number, transition in enumerate(unnamed)]
    levels, known = [{start}], {start}
    while levels[-1]:
        levels.append({after(t, code) for t in each for code in levels[-1] if possible(t, code)} - known)
        known |= levels[-1]
    paths = Paths(ENCODING, [np.array(sorted(level)) for level in levels[:-1]], each)
    for length, level in enumerate(levels):
        for end in level:
            way, code = paths.path_to(end), start
            assert len(way) == length
            for command in way:
                assert possible(each[int(command)], code)
                code = after(each[int(command)], code)
            assert code == end
