"""Measurement of the force on the flange of the simulated arm."""

from __future__ import annotations

from math import exp, pi, sqrt

import numpy as np

from pcmrs.spatial import Floats
from pcmrs_sim.settings import ArmSettings

BLOCK = 4096
"""Number of noise samples that are drawn at once, because single draws are slow."""


class ForceSensor:
    """The true force with white noise, smoothed by a first-order low-pass filter, as an arm's own estimate is.

    Args:
        axis_in_flange: The tool's +z, along which contact pushes, in the flange frame, (3,).
        settings: Noise and filter.
        step: Time between updates, s.
        rng: Source of the noise.

    Attributes:
        axis: The tool's +z, in the flange frame, (3,).
        flange_force: Estimated force on the flange's load, in the flange frame, N, (3,).
    """

    def __init__(self, axis_in_flange: Floats, settings: ArmSettings, step: float, rng: np.random.Generator) -> None:
        self.axis = axis_in_flange
        self._axis = axis_in_flange.tolist()
        self._noise = settings.force_noise
        self._gain = 1.0 - exp(-2 * pi * settings.force_filter_hz * step)
        self._rng = rng
        self._noise_block: list[list[float]] = []
        self.flange_force = (0.0, 0.0, 0.0)

    def update(self, force: float) -> None:
        """Take the true force along the tool's +z, N."""
        if not self._noise_block:
            self._noise_block = self._rng.normal(0.0, self._noise, (BLOCK, 3)).tolist()
        i, j, k = self._noise_block.pop()
        a, b, c = self._axis
        x, y, z = self.flange_force
        gain = self._gain
        self.flange_force = (
            x + gain * (a * force + i - x),
            y + gain * (b * force + j - y),
            z + gain * (c * force + k - z),
        )

    @property
    def magnitude(self) -> float:
        """Magnitude of the estimated force, N."""
        x, y, z = self.flange_force
        return sqrt(x * x + y * y + z * z)


class TrueForce:
    """The true force on the tool, without noise; see `pcmrs.devices.motion.force.FlangeForce`.

    Args:
        axis_in_flange: The tool's +z, along which contact pushes, in the flange frame, (3,).

    Attributes:
        axis: The tool's +z, in the flange frame, (3,).
        flange_force: Force on the flange's load, in the flange frame, N, (3,).
    """

    def __init__(self, axis_in_flange: Floats) -> None:
        self.axis = axis_in_flange
        self._axis = axis_in_flange.tolist()
        self.flange_force = (0.0, 0.0, 0.0)

    def update(self, force: float) -> None:
        """Take the true force along the tool's +z, N."""
        i, j, k = self._axis
        self.flange_force = (force * i, force * j, force * k)

    @property
    def magnitude(self) -> float:
        """Magnitude of the force, N."""
        x, y, z = self.flange_force
        return sqrt(x * x + y * y + z * z)
