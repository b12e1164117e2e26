"""Joint states as integers: one digit per branch, so that a million of them fit in an array."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from itertools import accumulate
from math import prod
from operator import mul
from typing import Any

import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.int64]
"""Joint states as integers, shape (n,)."""

Rows = NDArray[np.intp]
"""Positions in an array of codes."""

Mask = NDArray[np.bool_]
"""True for some of an array of codes, shape (n,)."""

MAX_COMBINATIONS = 2**62
"""More combinations than this cannot be distinguished by a 64-bit integer."""


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
        self.weights: list[int] = [1, *accumulate(self.sizes, mul)][:-1]
        self.combinations = prod(self.sizes)
        self.position = {name: digit for digit, name in enumerate(self.names)}
        self._value = [{value: index for index, value in enumerate(taken)} for taken in self.values]

    def value(self, name: str, value: str) -> int:
        """Return the digit that stands for `value`.

        Args:
            name: Name of the digit.
            value: One of its values.
        """
        return self._value[self.position[name]][value]

    def digit(self, code: int, position: int) -> int:
        """Return one digit of a code.

        Args:
            code: The code.
            position: Which digit.
        """
        return code // self.weights[position] % self.sizes[position]

    def code(self, values: Mapping[str, str]) -> int:
        """Return the number of a combination."""
        return sum(self.value(name, value) * self.weights[self.position[name]] for name, value in values.items())

    def decoded(self, code: int) -> dict[str, str]:
        """Return the combination that a number stands for."""
        digits = (code // weight % size for weight, size in zip(self.weights, self.sizes, strict=True))
        return {name: taken[digit] for name, taken, digit in zip(self.names, self.values, digits, strict=True)}


class Batch:
    """Some combinations, and what has been worked out for all of them.

    Args:
        encoding: Encoding of the codes.
        codes: Codes, shape (n,).
    """

    def __init__(self, encoding: Encoding, codes: Codes) -> None:
        self.codes = codes
        self._encoding = encoding
        self._cache: dict[str, NDArray[Any]] = {}

    @cached_property
    def digits(self) -> NDArray[np.int64]:
        """All digits of every code, shape (digits, n)."""
        weights, sizes = (np.array(each)[:, None] for each in (self._encoding.weights, self._encoding.sizes))
        found: NDArray[np.int64] = self.codes // weights % sizes
        return found

    def cached(self, name: str, make: Callable[[Batch], NDArray[Any]]) -> NDArray[Any]:
        """Return an array about this batch, made once for each name.

        Args:
            name: Key of the array.
            make: Makes the array.
        """
        if name not in self._cache:
            self._cache[name] = make(self)
        return self._cache[name]

    def matching(self, wanted: Mapping[str, Sequence[str]]) -> Mask:
        """Return a mask of the combinations that have, for each digit named, one of the wanted values; shape (n,)."""
        found = np.ones(len(self.codes), dtype=np.bool_)
        for name, values in wanted.items():
            digit = self._encoding.position[name]
            allowed = np.array([value in values for value in self._encoding.values[digit]])
            found &= allowed[self.digits[digit]]
        return found
