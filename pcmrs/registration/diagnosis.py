"""What an operator or a file got wrong as a whole: the unit, or the order of the landmarks.

A diagnosis is made only where it explains what noise does not: a good set is never refused for being a little
better explained by something else.
"""

from __future__ import annotations

import itertools

import numpy as np

from pcmrs.registration.outliers import chi_squared_limit
from pcmrs.registration.rigid import sums_of_squares
from pcmrs.spatial import Floats

ALL_PERMUTATIONS = 7
"""Up to so many landmarks all orders are tried (5,040); beyond, every exchange of two."""


def unit_ratio(planned: Floats, digitized: Floats) -> float:
    """How many times farther apart the digitized landmarks (N, 3) are than the planned ones.

    Of the median distances, so that one wrong landmark does not look like another unit; 1 where landmarks of a set
    coincide, which is no matter of units.
    """
    apart, between = _median_distance(digitized), _median_distance(planned)
    return apart / between if apart > 0.0 and between > 0.0 else 1.0


def explaining_order(planned: Floats, digitized: Floats, sigma: float, false_alarm: float) -> tuple[int, ...] | None:
    """The order of the planned landmarks in which they were touched, where they were touched in another one.

    Args:
        planned: m, (N, 3).
        digitized: m, (N, 3).
        sigma: Noise, standard deviation per axis, m.
        false_alarm: Share of sets in the right order of which noise is not believed to explain the residuals.

    Returns:
        For each digitized landmark the planned one it belongs to; None when noise explains the given order, or no
        other one.
    """
    limit = chi_squared_limit(3 * len(planned) - 6, false_alarm) * sigma**2
    if sums_of_squares(digitized[None], planned[None])[0] <= limit:
        return None
    orders = _orders(len(planned))
    squares = sums_of_squares(digitized[None], planned[orders])
    best = int(np.argmin(squares))
    return tuple(orders[best].tolist()) if squares[best] <= limit else None


def cycles(order: tuple[int, ...]) -> list[list[int]]:
    """The landmarks that an order exchanges among each other: a pair, or more of them in a ring."""
    found: list[list[int]] = []
    for start in range(len(order)):
        ring, at = [start], order[start]
        while at != start:
            ring.append(at)
            at = order[at]
        if len(ring) > 1 and start == min(ring):
            found.append(ring)
    return found


def _orders(count: int) -> np.ndarray[tuple[int, int], np.dtype[np.intp]]:
    """Every order but the given one; beyond `ALL_PERMUTATIONS`, only exchanges of two."""
    if count <= ALL_PERMUTATIONS:
        return np.array(list(itertools.permutations(range(count)))[1:])
    orders = np.tile(np.arange(count), (count * (count - 1) // 2, 1))
    for order, (a, b) in zip(orders, itertools.combinations(range(count), 2), strict=True):
        order[[a, b]] = b, a
    return orders


def _median_distance(points: Floats) -> float:
    """Median distance between two of the points (N, 3)."""
    first, second = np.triu_indices(len(points), k=1)
    return float(np.median(np.linalg.norm(points[first] - points[second], axis=1)))
