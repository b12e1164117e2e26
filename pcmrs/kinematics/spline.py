"""Cubic splines through rows of numbers: C. de Boor, A Practical Guide to Splines, Springer 1978, chapter IV.

SciPy has them, too; but `scipy.interpolate` takes longer to load than all else that a process needs to follow a motion.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dgtsv

from pcmrs.spatial import Floats


class CubicSpline:
    """The cubic spline through rows of numbers, with two continuous derivatives.

    Args:
        places: Where the rows are, rising, (K,): at least four, or two where `ends` are given.
        rows: What it passes through, (K, n).
        ends: Slopes at the first and the last place, (n,) each. None lets the first two intervals share one cubic, and
            the last two ("not a knot").
    """

    def __init__(
        self, places: npt.ArrayLike, rows: npt.ArrayLike, ends: tuple[npt.ArrayLike, npt.ArrayLike] | None = None
    ) -> None:
        self.places: Floats = np.asarray(places, dtype=float)
        self._rows: Floats = np.asarray(rows, dtype=float)
        self._steps: Floats = np.diff(self.places)
        self._slopes = _slopes(self._steps, self._rows, ends)

    def __call__(self, places: npt.ArrayLike, order: int = 0) -> Floats:
        """Its value at places (M,), or its derivative of order 1 or 2, (M, n)."""
        places = np.asarray(places, dtype=float)
        left = np.clip(np.searchsorted(self.places, places, side="right") - 1, 0, len(self._steps) - 1)
        step, away = self._steps[left, None], (places - self.places[left])[:, None]
        start, slope = self._rows[left], self._slopes[left]
        chord = (self._rows[left + 1] - start) / step
        excess = (slope + self._slopes[left + 1] - 2.0 * chord) / step
        third, second = excess / step, (chord - slope) / step - excess
        value: Floats = (
            start + away * (slope + away * (second + away * third)),
            slope + away * (2.0 * second + away * 3.0 * third),
            2.0 * second + away * 6.0 * third,
        )[order]
        return value


def _slopes(steps: Floats, rows: Floats, ends: tuple[npt.ArrayLike, npt.ArrayLike] | None) -> Floats:
    """The slopes at all places, (K, n), with which the second derivative is continuous."""
    chords = np.diff(rows, axis=0) / steps[:, None]
    below, above = np.append(steps[1:], 0.0), np.append(0.0, steps[:-1])
    main = np.concatenate(((1.0,), 2.0 * (steps[1:] + steps[:-1]), (1.0,)))
    right = np.empty_like(rows)
    right[1:-1] = 3.0 * (steps[1:, None] * chords[:-1] + steps[:-1, None] * chords[1:])
    if ends is None:
        (main[0], above[0], right[0]) = _not_a_knot(steps[0], steps[1], chords[0], chords[1])
        (main[-1], below[-1], right[-1]) = _not_a_knot(steps[-1], steps[-2], chords[-1], chords[-2])
    else:
        right[0], right[-1] = ends
    slopes: Floats = dgtsv(below, main, above, right)[3]
    return slopes


def _not_a_knot(near: float, next_: float, chord: Floats, next_chord: Floats) -> tuple[float, float, Floats]:
    """Coefficients of the slopes at an end and beside it, and the right-hand side, by which two intervals are one."""
    both = near + next_
    return next_, both, ((near + 2.0 * both) * next_ * chord + near**2 * next_chord) / both
