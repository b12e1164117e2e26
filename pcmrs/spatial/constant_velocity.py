"""A Kalman filter of constant velocity in three axes that share their noise, and so one covariance of value and rate.

The velocity is disturbed by white-noise acceleration of two levels: that of a body in motion is taken for a measurement
which that of a body at rest does not explain (Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and
Navigation, 2001, sections 6.2 and 11.2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pcmrs.spatial.transform import Floats

MOTION = 30.0
"""Squared innovation against its variance above which a frame shows motion: chi-squared of 3, at rest one in 700,000,
which is one false alarm in three hours at 60 Hz: each shakes an arm that follows."""


@dataclass(frozen=True, slots=True)
class Noise:
    """What is expected of translations (m) or rotations (rad), per axis.

    Attributes:
        measurement: Standard deviation of a measured pose.
        rest: Power spectral density of the acceleration of a body that breathes and drifts, unit squared / s^3.
        motion: The same of one that moves at will.
        rate: Standard deviation of the rate before anything is known of it, unit / s.
    """

    measurement: float
    rest: float
    motion: float
    rate: float


class VelocityFilter:
    """The rate (3,) and the covariance (2, 2) of value and rate; whoever uses it keeps the value.

    Args:
        noise: What is expected of the measurements and of the motion.

    Attributes:
        noise: The same.
        rate: What is known of the velocity, unit / s, (3,).
    """

    def __init__(self, noise: Noise) -> None:
        self.noise = noise
        self.rate = np.zeros(3)
        self._covariance = np.diag((noise.measurement**2, noise.rate**2))

    def predicted(self, passed: float, density: float) -> Floats:
        """The covariance after `passed` seconds with acceleration of some spectral density."""
        step = np.array(((1.0, passed), (0.0, 1.0)))
        spread = np.array(((passed**3 / 3.0, passed**2 / 2.0), (passed**2 / 2.0, passed)))
        covariance: Floats = step @ self._covariance @ step.T + density * spread
        return covariance

    def exceeds(self, deviations: float, passed: float, innovation: Floats) -> bool:
        """Whether an innovation (3,) has more than so many standard deviations of a body in motion."""
        variance = self.predicted(passed, self.noise.motion)[0, 0] + self.noise.measurement**2
        return bool(innovation @ innovation > deviations**2 * variance)

    def correct(self, passed: float, innovation: Floats) -> Floats:
        """Takes the innovation (3,) into the rate; returns by how much the predicted value is to be corrected, (3,)."""
        expected, variance = self.predicted(passed, self.noise.rest), self.noise.measurement**2
        if innovation @ innovation > MOTION * (expected[0, 0] + variance):
            expected = self.predicted(passed, self.noise.motion)
        gain = expected[:, 0] / (expected[0, 0] + variance)
        self._covariance = expected - np.outer(gain, expected[0])
        self.rate = self.rate + gain[1] * innovation
        corrected: Floats = gain[0] * innovation
        return corrected
