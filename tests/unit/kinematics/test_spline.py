import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import interpolate

from pcmrs.kinematics.time_parameterization import CubicSpline
from pcmrs.spatial import Floats


@st.composite
def rows_at_places(draw: st.DrawFn, fewest: int) -> tuple[Floats, Floats]:
    steps = np.array(draw(st.lists(st.floats(0.1, 3.0), min_size=fewest - 1, max_size=12)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    return np.concatenate(((0.0,), np.cumsum(steps))), rng.normal(size=(len(steps) + 1, 3))


@given(rows_at_places(4), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=9))
def test_without_slopes_at_its_ends_it_is_that_of_scipy(given: tuple[Floats, Floats], shares: list[float]) -> None:
    places, rows = given
    spline, expected = CubicSpline(places, rows), interpolate.CubicSpline(places, rows)
    at = places[-1] * np.array(shares)
    for order in range(3):
        np.testing.assert_allclose(spline(at, order), expected(at, order), rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(spline(places), rows, atol=1e-12)


@given(rows_at_places(2), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=9))
def test_with_slopes_at_its_ends_it_is_that_of_scipy(given: tuple[Floats, Floats], shares: list[float]) -> None:
    places, rows = given
    begin, end = np.array((1.0, -2.0, 0.5)), np.zeros(3)
    expected = interpolate.CubicSpline(places, rows, bc_type=((1, begin), (1, end)))
    spline = CubicSpline(places, rows, (begin, end))
    at = places[-1] * np.array(shares)
    for order in range(3):
        np.testing.assert_allclose(spline(at, order), expected(at, order), rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(spline(places[[0, -1]], 1), (begin, end), atol=1e-12)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_cubic_is_its_own_spline(order: int) -> None:
    places = np.array((0.0, 0.3, 1.0, 1.1, 2.0, 2.5))
    cubic = np.polynomial.Polynomial((0.4, -1.0, 0.7, 2.0))
    at = np.linspace(0.0, 2.5, 41)
    spline = CubicSpline(places, cubic(places)[:, None])
    np.testing.assert_allclose(spline(at, order)[:, 0], cubic.deriv(order)(at), atol=1e-9)
