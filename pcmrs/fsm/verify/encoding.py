"""Joint states as integers: one digit per branch, so that a million of them fit in an array."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod

import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.int64]
"""Joint states as integers, shape (n,)."""

Rows = NDArray[np.intp]
"""Positions in an array of codes."""

MAX_COMBINATIONS = 2**62
"""More combinations than this cannot be told apart by a 64-bit integer."""


class Encoding:
    """A mixed-radix number for every combination of values; the first digit is the least significant.

    Args:
        values: Name of each digit to the values it takes; the product of their numbers is at most
            `MAX_COMBINATIONS`.
    """

    def __init__(self, values: Mapping[str, Sequence[str]]) -> None:
        self.names = list(values)
        self.values = [list(taken) for taken in values.values()]
        self.sizes = [len(taken) for taken in self.values]
        self.weights = [prod(self.sizes[:digit]) for digit in range(len(self.sizes))]
        self.combinations = prod(self.sizes)
        self.position = {name: digit for digit, name in enumerate(self.names)}
        self._value = [{value: index for index, value in enumerate(taken)} for taken in self.values]

    def value(self, name: str, value: str) -> int:
        """What a digit is where it means `value`."""
        return self._value[self.position[name]][value]

    def code(self, values: Mapping[str, str]) -> int:
        """The number of a combination."""
        return sum(self.value(name, value) * self.weights[self.position[name]] for name, value in values.items())

    def decoded(self, code: int) -> dict[str, str]:
        """The combination that a number means."""
        digits = (code // weight % size for weight, size in zip(self.weights, self.sizes, strict=True))
        return {name: taken[digit] for name, taken, digit in zip(self.names, self.values, digits, strict=True)}


class Batch:
    """Some combinations, and their digits as far as they are asked for.

    Args:
        encoding: Of the codes.
        codes: Shape (n,).
    """

    def __init__(self, encoding: Encoding, codes: Codes) -> None:
        self.codes = codes
        self._encoding = encoding
        self._digits: dict[int, NDArray[np.uint16]] = {}
        self._where: dict[tuple[int, int], Rows] = {}

    def digit(self, position: int) -> NDArray[np.uint16]:
        """One digit of every code, shape (n,)."""
        if position not in self._digits:
            weight, size = self._encoding.weights[position], self._encoding.sizes[position]
            self._digits[position] = (self.codes // weight % size).astype(np.uint16)
        return self._digits[position]

    def where(self, position: int, value: int) -> Rows:
        """Where that digit has that value."""
        if (position, value) not in self._where:
            self._where[position, value] = np.flatnonzero(self.digit(position) == value)
        return self._where[position, value]

    def matching(self, wanted: Mapping[str, Sequence[str]]) -> NDArray[np.bool_]:
        """Which combinations have, for each digit named, one of the values wanted; shape (n,)."""
        found = np.ones(len(self.codes), dtype=np.bool_)
        for name, values in wanted.items():
            allowed = [self._encoding.value(name, value) for value in values]
            found &= np.isin(self.digit(self._encoding.position[name]), allowed)
        return found
