"""Kalman filter of constant velocity in three axes, which share one covariance of value and rate.

The axes share their covariance because they share their noise.
White-noise acceleration of two levels disturbs the velocity. A measurement that the level of a body at rest does not
explain is filtered with the level of a body in motion (Bar-Shalom, Li, Kirubarajan, Estimation with Applications to
Tracking and Navigation, 2001, sections 6.2 and 11.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcmrs.spatial._transform import Floats

MOTION_THRESHOLD = 30.0
"""Squared innovation over its variance above which a frame shows motion. It is chi-squared with 3 degrees of freedom. A
body at rest exceeds it once in 700,000 frames, which is one false alarm in three hours at 60 Hz. Each false alarm
shakes an arm that follows."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Expected noise of translations (unit m) or rotations (unit rad), per axis.

    Attributes:
        measurement: Standard deviation of a measured pose, unit.
        rest: Power spectral density of the acceleration of a body that breathes and drifts, unit squared / s^3.
        motion: Power spectral density of the acceleration of a body that moves deliberately, unit squared / s^3.
        rate: Standard deviation of the initial rate, unit / s.
    """

    measurement: float
    rest: float
    motion: float
    rate: float


class VelocityFilter:
    """Filtered rate (3,) and covariance (2, 2) of value and rate. The caller stores the value itself.

    Args:
        noise: Expected noise of the measurements and of the motion.

    Attributes:
        noise: Expected noise of the measurements and of the motion.
        rate: Estimated velocity, unit / s, (3,).
    """

    def __init__(self, noise: Noise) -> None:
        self.noise = noise
        self.rate = np.zeros(3)
        self._covariance = np.diag((noise.measurement**2, noise.rate**2))

    def predicted_covariance(self, elapsed: float, density: float) -> Floats:
        """Return the covariance of value and rate after some time, (2, 2).

        Args:
            elapsed: Time since the last measurement, s.
            density: Power spectral density of the acceleration, unit squared / s^3.
        """
        step = np.array(((1.0, elapsed), (0.0, 1.0)))
        # White-noise acceleration of unit density, integrated over the step.
        spread = np.array(((elapsed**3 / 3.0, elapsed**2 / 2.0), (elapsed**2 / 2.0, elapsed)))
        covariance: Floats = step @ self._covariance @ step.T + density * spread
        return covariance

    def is_outlier(self, deviations: float, elapsed: float, innovation: Floats) -> bool:
        """Return True if an innovation is larger than a body in motion explains.

        Args:
            deviations: Limit in standard deviations.
            elapsed: Time since the last measurement, s.
            innovation: Measured minus predicted value, unit, (3,).
        """
        variance = self.predicted_covariance(elapsed, self.noise.motion)[0, 0] + self.noise.measurement**2
        return bool(innovation @ innovation > deviations**2 * variance)

    def correct(self, elapsed: float, innovation: Floats) -> Floats:
        """Update the rate by an innovation, and return the correction of the predicted value.

        Args:
            elapsed: Time since the last measurement, s.
            innovation: Measured minus predicted value, unit, (3,).

        Returns:
            Correction to add to the predicted value, unit, (3,).
        """
        expected, variance = self.predicted_covariance(elapsed, self.noise.rest), self.noise.measurement**2
        # A body at rest is smoothed strongly, because its noise shakes an arm that follows. A body in motion is
        # followed fast.
        if innovation @ innovation > MOTION_THRESHOLD * (expected[0, 0] + variance):
            expected = self.predicted_covariance(elapsed, self.noise.motion)
        gain = expected[:, 0] / (expected[0, 0] + variance)
        self._covariance = expected - np.outer(gain, expected[0])
        self.rate = self.rate + gain[1] * innovation
        corrected: Floats = gain[0] * innovation
        return corrected
