"""Mean-shift test for one wrong landmark.

If landmark i is not shifted, leaving it out reduces the sum of squares over the variance by a chi-squared number with 3
degrees of freedom (R. D. Cook, S. Weisberg, Residuals and Influence in Regression, 1982, section 2.2.2; W. Baarda, A
Testing Procedure for Use in Geodetic Networks, 1968). The largest of the N reductions is compared with the quantile of
chi-squared(3) at the false-alarm rate over N, after Bonferroni.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pcmrs.registration._anisotropic import fit_anisotropic, inverse_covariances
from pcmrs.registration.rigid import fit_rigid, sums_of_squares
from pcmrs.spatial import Floats

__all__ = ["OutlierTest", "mean_shift_test"]

MIN_POINTS = 4
"""Least number of landmarks. With three, leaving out any one leaves no residual."""
SHIFT_DEGREES = 3


@dataclass(frozen=True, eq=False, slots=True)
class OutlierTest:
    """Result of the mean-shift test.

    Attributes:
        statistics: Reduction of the sum of squares over the variance by leaving out each landmark, (N,).
        limit: Greatest statistic that noise explains.
        suspect: Index of the landmark with the largest statistic, if that is above the limit; otherwise None.
        rivals: Indices of other landmarks whose shift would make the measurement at least `false_alarm` times as likely
            as the suspect's shift. With four landmarks there often are some, because only three distances check the
            remaining ones.
    """

    statistics: Floats
    limit: float
    suspect: int | None
    rivals: tuple[int, ...]


def mean_shift_test(fixed: Floats, moving: Floats, noise: float | Floats, false_alarm: float) -> OutlierTest:
    """Test whether one landmark is off by more than noise.

    Args:
        fixed: Points in the fixed frame, m, (N, 3), N >= 4.
        moving: The same points in the moving frame, m, (N, 3).
        noise: Standard deviation per axis, m, or covariances of the fixed points, m^2, (N, 3, 3).
        false_alarm: Share of sets without a wrong landmark in which one is suspected nevertheless.
    """
    count = len(fixed)
    total, without = _chi_squares(fixed, moving, noise)
    statistics = total - without
    limit = chi_squared_limit(SHIFT_DEGREES, false_alarm / count)
    suspect = int(np.argmax(statistics))
    if statistics[suspect] <= limit:
        return OutlierTest(statistics, limit, None, ())
    # Twice the logarithm of a likelihood ratio is the difference of chi-squares.
    likely = np.flatnonzero(statistics > statistics[suspect] + 2.0 * math.log(false_alarm))
    return OutlierTest(statistics, limit, suspect, tuple(int(i) for i in likely if i != suspect))


@lru_cache
def chi_squared_limit(degrees: int, false_alarm: float) -> float:
    """Return the value that a chi-squared number exceeds with a given probability.

    Found by halving, since the tail falls with the value. SciPy has its inverse, but every process of a cell would load
    SciPy for this number.

    Args:
        degrees: Degrees of freedom, at least 1.
        false_alarm: The probability, between 0 and 1.
    """
    low, high = 0.0, 1.0
    while _chi_squared_tail(degrees, high) > false_alarm:
        low, high = high, 2.0 * high
    while low < (middle := (low + high) / 2.0) < high:
        low, high = (middle, high) if _chi_squared_tail(degrees, middle) > false_alarm else (low, middle)
    return high


def _chi_squared_tail(degrees: int, value: float) -> float:
    """Probability that a chi-squared number exceeds `value`: a finite sum for whole degrees of freedom.

    M. Abramowitz, I. A. Stegun, Handbook of Mathematical Functions, 1964, 26.4.4 and 26.4.5.
    """
    half, odd = value / 2.0, degrees % 2
    tail = math.erfc(math.sqrt(half)) if odd else 0.0
    term = math.exp(-half) * (math.sqrt(half / math.pi) * 2.0 if odd else 1.0)
    for number in range(degrees // 2):
        tail += term
        term *= half / (number + 1.0 + odd / 2.0)
    return tail


def _chi_squares(fixed: Floats, moving: Floats, noise: float | Floats) -> tuple[float, Floats]:
    """Return the least sum of squares over the variance of all landmarks, and without each of them, (N,)."""
    others = np.array([np.delete(np.arange(len(fixed)), i) for i in range(len(fixed))])
    if isinstance(noise, float):
        total = sums_of_squares(fixed[None], moving[None])[0]
        return total / noise**2, sums_of_squares(fixed[others], moving[others]) / noise**2
    without = np.array([_mahalanobis(fixed[rows], moving[rows], noise[rows]) for rows in others])
    return _mahalanobis(fixed, moving, noise), without


def _mahalanobis(fixed: Floats, moving: Floats, covariances: Floats) -> float:
    fixed_from_moving = fit_anisotropic(fixed, moving, covariances, fit_rigid(fixed, moving))
    residuals = fixed_from_moving @ moving - fixed
    return float(np.einsum("ni,nij,nj->", residuals, inverse_covariances(covariances), residuals))
