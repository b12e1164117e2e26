"""How noisy landmarks are: estimated from what registrations leave over, pooled with what is known before."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError

MOTION_DEGREES = 6
"""Degrees of freedom that a rigid fit takes from the residuals."""


@dataclass(frozen=True, slots=True)
class NoiseEstimate:
    """Residuals collected so far, of one pointer in one workflow; immutable, so it may be kept and passed on.

    Attributes:
        sum_of_squares: Of the residual distances, m^2.
        degrees: Degrees of freedom in it: ``sum_of_squares / degrees`` estimates the variance per axis.
    """

    sum_of_squares: float = 0.0
    degrees: int = 0

    def with_residuals(self, distances: npt.ArrayLike, count: int) -> NoiseEstimate:
        """The estimate after one more registration.

        Its sum of squares over the variance per axis is chi-squared with 3N - 6 degrees of freedom (Fitzpatrick, West,
        Maurer, IEEE TMI 17 (1998): E[FRE^2] = (1 - 2/N) E[FLE^2]).

        Args:
            distances: Of the pairs after mapping, m, (N,).
            count: How many points the fit used, N.

        Raises:
            GeometryError: Fewer than three points, or a distance is not finite.
        """
        squares = float(np.sum(np.square(np.asarray(distances, dtype=float))))
        if count < 3 or not math.isfinite(squares):
            text = f"{count} points that left {squares:g} m^2 say nothing of noise; use a registration of 3 or more."
            raise GeometryError(text, count=count, sum_of_squares=squares)
        return NoiseEstimate(self.sum_of_squares + squares, self.degrees + 3 * count - MOTION_DEGREES)

    def sigma(self, prior_sigma: float, prior_degrees: float) -> float:
        """Standard deviation per axis, m: the pooled variance of the residuals and of a prior.

        The mean of the scaled inverse-chi-squared posterior of a normal variance (Gelman et al., Bayesian Data
        Analysis, 3rd ed., 2013, section 2.6) but for the 2 in its denominator.

        Args:
            prior_sigma: What is believed without any residuals, m.
            prior_degrees: How many degrees of freedom that belief is worth; more than zero.
        """
        pooled = self.sum_of_squares + prior_degrees * prior_sigma**2
        return math.sqrt(pooled / (self.degrees + prior_degrees))


def spread_of(samples: npt.ArrayLike) -> float:
    """Root mean square distance of the samples (K, 3) of one point from their mean, m.

    Raises:
        GeometryError: There is no sample, or the shape is wrong.
    """
    points = np.asarray(samples, dtype=float)
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise GeometryError(f"The samples have shape {points.shape}, must be (K, 3) with K >= 1.", shape=points.shape)
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
