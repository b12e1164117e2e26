"""Numbers and sizes on a command line: finite, and with a unit that is known."""

from __future__ import annotations

import math

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.cli.values import POSITIVE, Finite, Size

UNITS = {"": 1.0, "B": 1.0, "kB": 1e3, "MB": 1e6, "GB": 1e9}


@given(st.floats(-2.0, 2.0))
def test_a_number_within_the_range_is_taken_and_no_other(number: float) -> None:
    if -1.0 <= number <= 1.0:
        assert Finite(-1.0, 1.0).convert(repr(number), None, None) == number
    else:
        with pytest.raises(click.BadParameter, match="not in the range"):
            Finite(-1.0, 1.0).convert(repr(number), None, None)


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e999"])
def test_what_is_not_finite_is_refused_by_every_range(text: str) -> None:
    for kind in (Finite(), POSITIVE):
        with pytest.raises(click.BadParameter):
            kind.convert(text, None, None)


@given(st.integers(1, 10**6), st.sampled_from(sorted(UNITS)), st.sampled_from(["", " "]), st.booleans())
def test_a_size_is_its_number_times_its_unit(number: int, unit: str, space: str, upper: bool) -> None:
    text = f"{number}{space}{unit.upper() if upper else unit.lower()}"
    assert math.isclose(Size().convert(text, None, None), number * UNITS[unit])
    assert Size().convert(f"{number}.5{unit}", None, None) == pytest.approx((number + 0.5) * UNITS[unit])


@pytest.mark.parametrize("text", ["", "MB", "0", "0MB", "-1MB", "1e9", "1TB", "1 M B", "1,5MB", "nan"])
def test_what_is_no_size_is_refused_with_examples(text: str) -> None:
    with pytest.raises(click.BadParameter, match="such as 512MB or 4GB"):
        Size().convert(text, None, None)
