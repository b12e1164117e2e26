"""Which motions of a body can be."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.jumps import SAME_PLACE, JumpGuard, PoseLimits
from pcmrs.spatial import Transform

PERIOD = 1 / 60
LIMITS = PoseLimits(speed=2.0, turn=20.0, steady=5)


def _at(x: float, angle: float = 0.0) -> Transform:
    return Transform.from_rotvec((x, 0.0, 0.0), (0.0, 0.0, angle))


def _doubts(guard: JumpGuard, places: list[Transform], body: str = "coil", start: int = 0) -> list[str]:
    return [guard.rejection_reason(body, (start + i) * PERIOD, place) for i, place in enumerate(places)]


def test_a_body_may_move_as_fast_as_the_limit() -> None:
    step = 0.99 * LIMITS.speed * PERIOD
    assert _doubts(JumpGuard(LIMITS), [_at(i * step) for i in range(20)]) == [""] * 20
    turn = 0.99 * LIMITS.turn * PERIOD
    assert _doubts(JumpGuard(LIMITS), [_at(0.0, i * turn) for i in range(20)]) == [""] * 20


@pytest.mark.parametrize("there", [_at(1.01 * LIMITS.speed * PERIOD), _at(0.0, 1.01 * LIMITS.turn * PERIOD)])
def test_one_that_jumps_is_doubted_until_it_has_been_steady(there: Transform) -> None:
    places = [_at(0.0)] * 3 + [there] * (LIMITS.steady + 2)
    assert _doubts(JumpGuard(LIMITS), places) == [""] * 3 + ["jump"] * LIMITS.steady + [""] * 2


def test_one_frame_elsewhere_costs_a_jump_there_and_back() -> None:
    places = [_at(0.0), _at(0.1)] + [_at(0.0)] * (LIMITS.steady + 1)
    assert _doubts(JumpGuard(LIMITS), places) == ["", "jump"] + ["jump"] * LIMITS.steady + [""]


def test_a_body_that_was_hidden_may_have_gone_far() -> None:
    guard = JumpGuard(LIMITS)
    assert guard.rejection_reason("coil", 0.0, _at(0.0)) == ""
    assert guard.rejection_reason("coil", 1.0, _at(1.9)) == ""


def test_a_frame_that_is_not_newer_does_not_make_it_steady() -> None:
    guard = JumpGuard(LIMITS)
    _doubts(guard, [_at(0.0), _at(0.5)])
    assert {guard.rejection_reason("coil", PERIOD, _at(0.5)) for _ in range(50)} == {"stamp_not_advancing"}
    assert guard.rejection_reason("coil", 2 * PERIOD, _at(0.5)) == "jump"


def test_swapped_bodies_are_rejected_at_each_others_place() -> None:
    guard, places = JumpGuard(LIMITS), {"coil": _at(0.0), "body_ref": _at(0.4)}
    for body, place in places.items():
        assert set(_doubts(guard, [place] * 3, body)) == {""}
    for body, other in (("coil", "body_ref"), ("body_ref", "coil")):
        assert set(_doubts(guard, [places[other]] * 100, body, start=3)) == {"swapped"}
    for body, place in places.items():
        assert _doubts(guard, [place] * (LIMITS.steady + 1), body, start=103)[-1] == ""


@pytest.mark.parametrize("missing", [0, 1, 3, 30])
def test_swapped_bodies_are_rejected_also_after_missing_frames(missing: int) -> None:
    guard, places = JumpGuard(LIMITS), {"coil": _at(0.0), "body_ref": _at(0.1)}
    for body, place in places.items():
        assert set(_doubts(guard, [place] * 3, body)) == {""}
    for number in range(3 + missing, 50 + missing):
        for body, other in (("coil", "body_ref"), ("body_ref", "coil")):
            assert _doubts(guard, [places[other]], body, start=number) == ["swapped"]


def test_body_that_nears_another_without_a_jump_is_accepted() -> None:
    guard = JumpGuard(LIMITS)
    _doubts(guard, [_at(0.0)], "body_ref")
    assert set(_doubts(guard, [_at(0.3 - 0.01 * i) for i in range(30)])) == {""}
    assert SAME_PLACE > 0.01


def test_nothing_is_known_of_a_body_that_was_forgotten() -> None:
    guard = JumpGuard(LIMITS)
    _doubts(guard, [_at(0.0), _at(0.5)])
    guard.forget("coil")
    assert guard.rejection_reason("coil", 0.0, _at(9.0)) == ""


@given(st.lists(st.floats(-10.0, 10.0), max_size=60))
def test_no_two_accepted_frames_in_succession_are_a_jump_apart(places: list[float]) -> None:
    doubts = _doubts(JumpGuard(LIMITS), [_at(x) for x in places])
    for i in range(1, len(places)):
        if doubts[i] == doubts[i - 1] == "":
            assert abs(places[i] - places[i - 1]) <= LIMITS.speed * PERIOD + 1e-12


@given(st.lists(st.tuples(st.floats(-1e3, 1e3), st.floats(-math.pi, math.pi)), max_size=30))
def test_without_limits_nothing_is_doubted(places: list[tuple[float, float]]) -> None:
    assert set(_doubts(JumpGuard(PoseLimits()), [_at(*place) for place in places])) <= {""}
    assert np.isinf(PoseLimits().speed)


def test_swap_with_a_moving_body_is_rejected_until_it_is_undone() -> None:
    """The head moves by more than two bodies may be apart, while the tracker takes the tool for it."""
    guard, coil, head = JumpGuard(LIMITS), _at(0.0), 0.4
    for body, place in (("coil", coil), ("body_ref", _at(head))):
        _doubts(guard, [place] * 3, body)
    moving = [_at(head + 1e-3 * step) for step in range(100)]
    for number, seen in enumerate(moving, start=3):
        assert _doubts(guard, [seen], "coil", start=number) == ["swapped"]
        assert _doubts(guard, [coil], "body_ref", start=number) == ["swapped"]
    for body, place in (("coil", coil), ("body_ref", moving[-1])):
        assert _doubts(guard, [place] * (LIMITS.steady + 1), body, start=103) == ["jump"] * LIMITS.steady + [""]


def test_unseen_body_is_rejected_at_the_place_of_another() -> None:
    """The hidden pointer would keep the reference from being believed for ever, at the place that it took."""
    guard = JumpGuard(LIMITS)
    _doubts(guard, [_at(0.0)] * 3, "body_ref")
    assert set(_doubts(guard, [_at(0.0)] * 100, "pointer", start=3)) == {"swapped"}
    assert set(_doubts(guard, [_at(0.0)] * 3, "body_ref", start=103)) == {""}
    assert _doubts(guard, [_at(0.5)] * (LIMITS.steady + 1), "pointer", start=106)[-1] == ""
