"""Numbers on the cabinet's wire: as Java writes and reads them."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs_sim.kst.java import java_double, numbers, parse_double, reply


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0.0"),
        (-0.0, "-0.0"),
        (1.0, "1.0"),
        (-1.57, "-1.57"),
        (0.001, "0.001"),
        (0.0009999, "9.999E-4"),
        (0.0001, "1.0E-4"),
        (-1.5e-10, "-1.5E-10"),
        (9999999.0, "9999999.0"),
        (1e7, "1.0E7"),
        (12345678.0, "1.2345678E7"),
        (3.141592653589793, "3.141592653589793"),
        (1.7976931348623157e308, "1.7976931348623157E308"),
        (2.2250738585072014e-308, "2.2250738585072014E-308"),
        (5e-324, "4.9E-324"),  # Double.MIN_VALUE
        (1e23, "1.0E23"),
        (float("inf"), "Infinity"),
        (float("-inf"), "-Infinity"),
        (float("nan"), "NaN"),
    ],
)
def test_double_to_string(value: float, text: str) -> None:
    assert java_double(value) == text


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_every_number_comes_back(value: float) -> None:
    text = java_double(value)
    assert float(text) == value
    mantissa, _, exponent = text.lstrip("-").partition("E")
    whole, point, fraction = mantissa.partition(".")
    assert point
    assert fraction
    if exponent:
        assert whole in "123456789"
        assert not 1e-3 <= abs(value) < 1e7


def test_a_reply_ends_every_number() -> None:
    assert reply([0.5, -1e-4]) == "0.5_-1.0E-4_\n"


def test_requests_are_read_as_java_reads_them() -> None:
    assert numbers("jp_1.00000_-2_3e-1__.5d_") == [1.0, -2.0, 0.3, 0.5]
    assert numbers("doPTPinJS") == []


@pytest.mark.parametrize("token", ["", "x", "nan", "inf", "1e999", "1_000", "0x10", "٣", "1.2.3"])
def test_text_that_is_no_number_is_refused(token: str) -> None:
    with pytest.raises(ValueError, match=r"number|great"):
        parse_double(token)
