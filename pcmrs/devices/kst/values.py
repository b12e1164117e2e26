"""Numbers on the wire: ours with five decimals, the cabinet's as Java's ``Double.toString`` writes them."""

from __future__ import annotations

import re
from collections.abc import Iterable
from math import isfinite

import numpy as np

from pcmrs.errors import DeviceError, PayloadError
from pcmrs.spatial import Floats

_JAVA_DOUBLE = re.compile(r"-?[0-9]+\.[0-9]+(E-?[0-9]+)?")
SEPARATOR = "_"


def parse_values(line: str, count: int) -> Floats:
    """The numbers of a reply, (count,).

    Raises:
        PayloadError: It does not hold `count` finite numbers.
    """
    words = line.removesuffix(SEPARATOR).split(SEPARATOR)
    if len(words) != count or not all(_JAVA_DOUBLE.fullmatch(word) for word in words):
        raise PayloadError(f"The cabinet answered {line[:80]!r}, not {count} numbers.", line=line[:80], count=count)
    values = np.array([float(word) for word in words])
    if not np.isfinite(values).all():
        raise PayloadError(f"The cabinet answered {line[:80]!r}, which is too great a number.", line=line[:80])
    return values


def words(values: Iterable[float]) -> str:
    """Numbers with five decimals, joined.

    Raises:
        DeviceError: One is not finite; nothing was sent.
    """
    numbers = [float(value) for value in values]
    if not all(isfinite(number) for number in numbers):
        raise DeviceError("A number for the cabinet is not finite; nothing was sent.")
    return SEPARATOR.join(f"{number:.5f}" for number in numbers)
