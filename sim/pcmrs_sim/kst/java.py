"""Numbers as Java writes and reads them."""

from __future__ import annotations

import re
from decimal import Decimal
from math import isfinite, isnan

_DECIMAL = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?[dDfF]?\s*", re.ASCII)
_PLAIN = (1e-3, 1e7)
"""Range of magnitudes that Java writes without an exponent."""


def java_double(value: float) -> str:
    """Return ``Double.toString(value)``: the shortest digits that identify the number, at least one after the point.

    If one digit identifies it, the nearest number of two digits is taken, which differs for the tiniest numbers only.
    This follows the specification since JDK 19; older JDKs sometimes write one more digit.
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
    """Return ``Double.parseDouble(token)`` for a decimal number.

    Raises:
        ValueError: The token is not a decimal number, or the number is not finite.
    """
    if _DECIMAL.fullmatch(token) is None:
        raise ValueError(f"{token!r} is not a decimal number")
    value = float(token.strip().rstrip("dDfF"))
    if not isfinite(value):
        raise ValueError(f"{token!r} is too great")
    return value


def numbers(line: str) -> list[float]:
    """Return the numbers after the name of a request. Empty tokens are skipped, as ``StringTokenizer`` does.

    Raises:
        ValueError: A token is not a number.
    """
    return [parse_double(token) for token in line.split("_")[1:] if token]


def reply(values: list[float]) -> str:
    """Return a reply of numbers, each followed by ``_``, with a line feed at the end."""
    return "".join(f"{java_double(value)}_" for value in values) + "\n"
