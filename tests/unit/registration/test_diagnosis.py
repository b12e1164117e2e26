"""A wrong unit or order is diagnosed only if it explains residuals that noise does not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.registration._diagnosis import cycles, detect_order, unit_ratio
from tests.unit.registration.landmark_layouts import FEMUR, HEAD, HEAD_SIGMA, any_motion, touched
from tests.unit.registration.random_sets import seeds

FALSE_ALARM = 0.01


@given(seeds, st.floats(1e-3, 1e3))
def test_ratio_of_sizes_is_that_of_the_units(seed: int, unit: float) -> None:
    rng = np.random.default_rng(seed)
    assert unit_ratio(HEAD, unit * (any_motion(rng) @ HEAD)) == pytest.approx(unit)


def test_one_wrong_landmark_does_not_look_like_a_unit() -> None:
    wrong = HEAD.copy()
    wrong[0] += (1.0, 1.0, 1.0)
    assert 0.5 < unit_ratio(HEAD, wrong) < 2.0


def test_landmarks_at_one_place_are_no_matter_of_units() -> None:
    place = np.ones((6, 3))
    assert unit_ratio(HEAD, place) == unit_ratio(place, HEAD) == 1.0


@given(seeds, st.permutations(range(6)))
def test_an_order_is_found_from_nearly_exact_landmarks(seed: int, order: list[int]) -> None:
    rng = np.random.default_rng(seed)
    digitized = touched(rng, HEAD, 1e-5)[order]
    assert detect_order(HEAD, digitized, 1e-4, FALSE_ALARM) == (None if order == sorted(order) else tuple(order))


def test_noise_seldom_looks_like_another_order() -> None:
    rng = np.random.default_rng(1)
    found = [detect_order(HEAD, touched(rng, HEAD, HEAD_SIGMA), HEAD_SIGMA, FALSE_ALARM) for _ in range(300)]
    assert sum(order is not None for order in found) <= 3


def test_residuals_that_no_order_explains_are_no_exchange() -> None:
    wrong = FEMUR.copy()
    wrong[2] += (0.0, 0.03, 0.0)
    assert detect_order(FEMUR, wrong, 1e-4, FALSE_ALARM) is None


@given(st.permutations(range(7)))
def test_the_rings_of_an_order_restore_it(order: list[int]) -> None:
    restored = list(range(7))
    rings = cycles(tuple(order))
    for ring in rings:
        for place, source in zip(ring, [*ring[1:], ring[0]], strict=True):
            restored[place] = source
    assert restored == order
    assert all(len(ring) > 1 for ring in rings)
