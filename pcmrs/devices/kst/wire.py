"""Framing and number format of KST: replies are lines, however the network splits and merges them.

Our numbers have five decimals; the cabinet writes numbers like Java's ``Double.toString``.
"""

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
    """Return the numbers of a reply, (count,).

    Args:
        line: Reply.
        count: Number of values that it must hold.

    Raises:
        PayloadError: The reply does not hold `count` finite numbers.
    """
    words = line.removesuffix(SEPARATOR).split(SEPARATOR)
    if len(words) != count or not all(_JAVA_DOUBLE.fullmatch(word) for word in words):
        raise PayloadError(f"The cabinet answered {line[:80]!r}, not {count} numbers.", line=line[:80], count=count)
    values = np.array([float(word) for word in words])
    if not np.isfinite(values).all():
        raise PayloadError(f"The cabinet answered {line[:80]!r}: a number is too large.", line=line[:80])
    return values


def words(values: Iterable[float]) -> str:
    """Return numbers with five decimals, joined by `SEPARATOR`.

    Raises:
        DeviceError: A number is not finite; nothing was sent.
    """
    numbers = [float(value) for value in values]
    if not all(isfinite(number) for number in numbers):
        raise DeviceError("A number for the cabinet is not finite; nothing was sent.")
    return SEPARATOR.join(f"{number:.5f}" for number in numbers)


LONGEST = 512
"""Longest reply without its end, bytes; seven numbers take 175 at most."""
END = b"\n"
"""End of a command or reply."""


class LineBuffer:
    """Buffer that collects bytes until lines are complete."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Return the lines that `data` completes, without their ends.

        Raises:
            PayloadError: A line is too long, or holds bytes that are not printable ASCII.
        """
        *lines, self._rest = (self._rest + data).split(END)
        for line in (*lines, self._rest):
            _check(line)
        return [line.decode("ascii") for line in lines]


def _check(line: bytes) -> None:
    if len(line) > LONGEST:
        text = f"A reply of the cabinet holds {len(line)} bytes without an end, limit {LONGEST}; is this a KST server?"
        raise PayloadError(text, bytes=len(line), limit=LONGEST)
    if any(not 0x20 <= byte < 0x7F for byte in line):
        raise PayloadError(f"A reply of the cabinet is not printable text: {line[:40]!r}; is this a KST server?")
