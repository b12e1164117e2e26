"""Joint states as integers: one digit per branch, so that a million of them fit in an array."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import accumulate, pairwise
from math import prod
from operator import mul
from typing import Any

import numpy as np
from numpy.typing import NDArray

Codes = NDArray[np.int64]
"""Joint states as integers, shape (n,)."""

Digits = NDArray[np.unsignedinteger[Any]]
"""One digit of each of an array of codes, shape (n,)."""

Rows = NDArray[np.intp]
"""Positions in an array of codes."""

MAX_COMBINATIONS = 2**62
"""More combinations than this cannot be distinguished by a 64-bit integer."""

FEW = 8
"""Number of a digit's values up to which comparing one by one is faster than sorting."""


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
        self.weights = [1, *accumulate(self.sizes, mul)][:-1]
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

    def code(self, values: Mapping[str, str]) -> int:
        """Return the number of a combination."""
        return sum(self.value(name, value) * self.weights[self.position[name]] for name, value in values.items())

    def decoded(self, code: int) -> dict[str, str]:
        """Return the combination that a number stands for."""
        digits = (code // weight % size for weight, size in zip(self.weights, self.sizes, strict=True))
        return {name: taken[digit] for name, taken, digit in zip(self.names, self.values, digits, strict=True)}


class Batch:
    """Some combinations, and those of their digits that have been needed.

    Args:
        encoding: Encoding of the codes.
        codes: Codes, shape (n,).
    """

    def __init__(self, encoding: Encoding, codes: Codes) -> None:
        self.codes = codes
        self._encoding = encoding
        self._digits: dict[int, Digits] = {}
        self._cache: dict[str, NDArray[np.bool_]] = {}
        self._split: dict[int, list[tuple[int, Rows]]] = {}

    def digit(self, position: int) -> Digits:
        """Return one digit of every code, shape (n,)."""
        if position not in self._digits:
            weight, size = self._encoding.weights[position], self._encoding.sizes[position]
            # The fewest bits that hold the digit: mostly an eighth of the memory of the codes.
            self._digits[position] = (self.codes // weight % size).astype(np.min_scalar_type(size - 1))
        return self._digits[position]

    def split(self, position: int, rows: Rows | None = None) -> Iterable[tuple[int, Rows]]:
        """Return the values of one digit, and the rows that have each.

        Args:
            position: Which digit.
            rows: Rows to look at; all by default.
        """
        size = self._encoding.sizes[position]
        if rows is not None:
            return _parts(self.digit(position)[rows], rows, size)
        if position not in self._split:
            self._split[position] = list(_parts(self.digit(position), np.arange(len(self.codes)), size))
        return self._split[position]

    def rows_among(self, position: int, values: Sequence[int], rows: Rows | None = None) -> Rows:
        """Return the rows in which one digit has one of some values.

        Args:
            position: Which digit.
            values: Values of the digit.
            rows: Rows to look at; all by default.
        """
        wanted = np.zeros(self._encoding.sizes[position], dtype=np.bool_)
        wanted[list(values)] = True
        if rows is None:
            return np.flatnonzero(wanted[self.digit(position)])
        return rows[wanted[self.digit(position)[rows]]]

    def cached(self, name: str, ask: Callable[[Batch], NDArray[np.bool_]]) -> NDArray[np.bool_]:
        """Return a mask of this batch, shape (n,), computed once for each name.

        Args:
            name: Key of the mask.
            ask: Computes the mask.
        """
        if name not in self._cache:
            self._cache[name] = ask(self)
        return self._cache[name]

    def matching(self, wanted: Mapping[str, Sequence[str]]) -> NDArray[np.bool_]:
        """Return a mask of the combinations that have, for each digit named, one of the wanted values; shape (n,)."""
        found = np.ones(len(self.codes), dtype=np.bool_)
        for name, values in wanted.items():
            digit = self._encoding.position[name]
            allowed = np.array([value in values for value in self._encoding.values[digit]])
            found &= allowed[self.digit(digit)]
        return found


def _parts(digits: Digits, rows: Rows, size: int) -> Iterator[tuple[int, Rows]]:
    if size <= FEW:
        yield from ((value, rows[digits == value]) for value in range(size))
        return
    # Stable, so that the rows of each value stay in order, nearest joint states first.
    order = np.argsort(digits, kind="stable")
    bounds = [0, *(np.flatnonzero(np.diff(digits[order])) + 1), len(digits)]
    yield from ((int(digits[order[start]]), rows[order[start:end]]) for start, end in pairwise(bounds) if start < end)
