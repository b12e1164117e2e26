"""Diagnosis of mistakes that affect all landmarks: a wrong unit or a wrong order.

A diagnosis is made only if it explains residuals that noise does not explain. A good set is never refused because
another explanation fits slightly better.
"""

from __future__ import annotations

import itertools

import numpy as np

from pcmrs.registration.outliers import chi_squared_limit
from pcmrs.registration.rigid import sums_of_squares
from pcmrs.spatial import Floats

ALL_PERMUTATIONS = 7
"""Largest number of landmarks for which all orders are tried (5,040). For more, every exchange of two is tried."""


def unit_ratio(planned: Floats, digitized: Floats) -> float:
    """Return the ratio of the distances among the digitized landmarks to those among the planned ones.

    It compares medians, so that one wrong landmark does not look like another unit. It is 1 if landmarks of a set
    coincide, which is not a matter of units.

    Args:
        planned: Landmarks as planned, in any frame, (N, 3).
        digitized: Landmarks as digitized, in any frame, (N, 3).
    """
    apart, between = _median_distance(digitized), _median_distance(planned)
    return apart / between if apart > 0.0 and between > 0.0 else 1.0


def detect_order(planned: Floats, digitized: Floats, sigma: float, false_alarm: float) -> tuple[int, ...] | None:
    """Return the order in which the planned landmarks were touched if it was not the planned one.

    Args:
        planned: Landmarks as planned, m, (N, 3).
        digitized: Landmarks as digitized, m, (N, 3).
        sigma: Noise of a landmark, standard deviation per axis, m.
        false_alarm: Share of sets in the right order whose residuals are not attributed to noise.

    Returns:
        For each digitized landmark the index of its planned one; None if noise explains the given order, or explains no
        other order.
    """
    limit = chi_squared_limit(3 * len(planned) - 6, false_alarm) * sigma**2
    if sums_of_squares(digitized[None], planned[None])[0] <= limit:
        return None
    orders = _orders(len(planned))
    squares = sums_of_squares(digitized[None], planned[orders])
    best = int(np.argmin(squares))
    return tuple(orders[best].tolist()) if squares[best] <= limit else None


def cycles(order: tuple[int, ...]) -> list[list[int]]:
    """Return the groups of landmarks that an order exchanges: a pair, or more landmarks in a cycle."""
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
    """Return every order but the given one; above `ALL_PERMUTATIONS` landmarks, only exchanges of two."""
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
