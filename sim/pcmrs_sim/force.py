"""What the simulated arm knows of the force on its flange."""

from __future__ import annotations

from math import exp, pi, sqrt

import numpy as np

from pcmrs.spatial import Floats
from pcmrs_sim.settings import ArmSettings

BLOCK = 4096  # noise drawn at once


class ForceSensor:
    """The true force with white noise, smoothed by a low-pass of first order, as an arm's own estimate is.

    Args:
        axis_in_flange: The tool's +z, along which contact pushes, (3,).
        settings: Of noise and filter.
        step: Time between updates, s.
        rng: Where the noise comes from.

    Attributes:
        axis: The tool's +z, along the flange's axes, (3,).
        flange_force: On what the flange carries, N, along the flange's axes.
    """

    def __init__(self, axis_in_flange: Floats, settings: ArmSettings, step: float, rng: np.random.Generator) -> None:
        self.axis = axis_in_flange
        self._axis = axis_in_flange.tolist()
        self._noise = settings.force_noise
        self._share = 1.0 - exp(-2 * pi * settings.force_filter_hz * step)
        self._rng = rng
        self._drawn: list[list[float]] = []
        self.flange_force = (0.0, 0.0, 0.0)

    def update(self, force: float) -> None:
        """Takes the present true force along the tool's +z, N."""
        if not self._drawn:
            self._drawn = self._rng.normal(0.0, self._noise, (BLOCK, 3)).tolist()
        i, j, k = self._drawn.pop()
        a, b, c = self._axis
        x, y, z = self.flange_force
        share = self._share
        self.flange_force = (
            x + share * (a * force + i - x),
            y + share * (b * force + j - y),
            z + share * (c * force + k - z),
        )

    @property
    def magnitude(self) -> float:
        """Of the estimate, N."""
        x, y, z = self.flange_force
        return sqrt(x * x + y * y + z * z)
