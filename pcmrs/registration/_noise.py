"""Noise of landmarks, estimated from the residuals of registrations and pooled with a prior."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError

MOTION_DEGREES = 6
"""Degrees of freedom that a rigid fit removes from the residuals."""


@dataclass(frozen=True, slots=True)
class NoiseEstimate:
    """Residuals collected with one pointer in one workflow. It is immutable, so it may be stored and passed on.

    Attributes:
        sum_of_squares: Sum of the squared residual distances, m^2.
        degrees: Degrees of freedom of that sum: ``sum_of_squares / degrees`` estimates the variance per axis.
    """

    sum_of_squares: float = 0.0
    degrees: int = 0

    def with_residuals(self, distances: npt.ArrayLike, count: int) -> NoiseEstimate:
        """Return the estimate after one more registration.

        Its sum of squares over the variance per axis is chi-squared with 3N - 6 degrees of freedom (Fitzpatrick, West,
        Maurer, IEEE TMI 17 (1998): E[FRE^2] = (1 - 2/N) E[FLE^2]).

        Args:
            distances: Distances of the pairs after registration, m, (N,).
            count: Number N of points that the fit used.

        Raises:
            GeometryError: There are fewer than three points, or a distance is not finite.
        """
        squares = float(np.sum(np.square(np.asarray(distances, dtype=float))))
        if count < 3 or not math.isfinite(squares):
            text = f"{count} points that left {squares:g} m^2 say nothing of noise; use a registration of 3 or more."
            raise GeometryError(text, count=count, sum_of_squares=squares)
        return NoiseEstimate(self.sum_of_squares + squares, self.degrees + 3 * count - MOTION_DEGREES)

    def sigma(self, prior_sigma: float, prior_degrees: float) -> float:
        """Return the standard deviation per axis from the pooled variance of the residuals and of a prior, m.

        The pooled variance is the mean of the scaled inverse-chi-squared posterior of a normal variance (Gelman et al.,
        Bayesian Data Analysis, 3rd ed., 2013, section 2.6), except for the 2 in its denominator.

        Args:
            prior_sigma: Standard deviation per axis that is assumed without any residuals, m.
            prior_degrees: Number of degrees of freedom that the prior is worth; more than zero.
        """
        pooled = self.sum_of_squares + prior_degrees * prior_sigma**2
        return math.sqrt(pooled / (self.degrees + prior_degrees))


def rms_spread(samples: npt.ArrayLike) -> float:
    """Return the root mean square distance of samples (K, 3) of one point from their mean, m.

    Raises:
        GeometryError: There is no sample, or the shape is wrong.
    """
    points = np.asarray(samples, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise GeometryError(f"The samples have shape {points.shape}, must be (K, 3) with K >= 1.", shape=points.shape)
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
