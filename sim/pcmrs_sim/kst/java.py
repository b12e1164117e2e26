"""Numbers as Java writes and reads them."""

from __future__ import annotations

import re
from decimal import Decimal
from math import isfinite, isnan

_DECIMAL = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?[dDfF]?\s*", re.ASCII)
_PLAIN = (1e-3, 1e7)
"""Within this range of magnitudes there is no exponent."""


def java_double(value: float) -> str:
    """``Double.toString(value)``: the shortest digits that tell the number, at least one of them behind the point.

    Where one digit tells it, the nearest of those with two is taken, which differs for the tiniest numbers only.
    Since JDK 19 this is what the specification says; older ones sometimes write a digit more.
    """
    if isnan(value):
        return "NaN"
    if not isfinite(value):
        return "Infinity" if value > 0.0 else "-Infinity"
    if value == 0.0 or _PLAIN[0] <= abs(value) < _PLAIN[1]:
        return repr(float(value))
    shortest = Decimal(repr(float(value))).normalize()
    text = f"{value:.1e}" if len(shortest.as_tuple().digits) == 1 else f"{shortest:e}"
    mantissa, exponent = text.split("e")
    return f"{mantissa}E{int(exponent)}"


def parse_double(token: str) -> float:
    """``Double.parseDouble(token)`` for a decimal number.

    Raises:
        ValueError: It is none, or not finite.
    """
    if _DECIMAL.fullmatch(token) is None:
        raise ValueError(f"{token!r} is no decimal number")
    value = float(token.strip().rstrip("dDfF"))
    if not isfinite(value):
        raise ValueError(f"{token!r} is too great")
    return value


def numbers(line: str) -> list[float]:
    """The numbers after the name of a request; empty tokens are passed over, as ``StringTokenizer`` does.

    Raises:
        ValueError: A token is no number.
    """
    return [parse_double(token) for token in line.split("_")[1:] if token]


def reply(values: list[float]) -> str:
    """A reply of numbers: each followed by ``_``, ended by a line feed."""
    return "".join(f"{java_double(value)}_" for value in values) + "\n"
