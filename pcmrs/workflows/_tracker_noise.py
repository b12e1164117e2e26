"""Tolerance of a placement, from the noise with which the tracker sees the tool at rest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from pcmrs.spatial import Floats, Transform, mean_transform
from pcmrs.workflows.settings import PlacementSettings

WIDEST_MM, WIDEST_DEG = 0.5, 0.2
"""Greatest tolerance that noise may cause, mm and deg: what the published placements miss their plans by."""
GROUPS = 4
"""Number of means of successive frames by whose scatter the noise is measured."""


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Errors within which a tool counts as placed.

    Attributes:
        mm: Distance, mm.
        deg: Angle, deg.
        noise_mm: Noise of the measured position, mm.
        noise_deg: Noise of the measured rotation, deg.
    """

    mm: float
    deg: float
    noise_mm: float
    noise_deg: float

    @classmethod
    def by_noise(cls, frames: Sequence[Transform], limits: PlacementSettings) -> Self:
        """Return the tolerance for a tracker that is as noisy as in a measurement, and for the arm's repeatability.

        A tighter one than the noise would be met by luck only, after many corrections.

        Args:
            frames: Measured pose of the tool in each frame, at rest.
            limits: Settings with the tolerance for a tracker without noise.
        """
        noise_mm, noise_deg = noise(frames)
        return cls(
            mm=max(
                limits.tolerance_mm,
                min(WIDEST_MM, math.hypot(limits.noise_factor * noise_mm, limits.repeatability_mm)),
            ),
            deg=max(limits.tolerance_deg, min(WIDEST_DEG, limits.noise_factor * noise_deg)),
            noise_mm=noise_mm,
            noise_deg=noise_deg,
        )

    @property
    def text(self) -> str:
        """The noise, and what counts because of it, for people."""
        return (
            f"noise {self.noise_mm:.2f} mm and {self.noise_deg:.2f}°: placements within {self.mm:.2f} mm and "
            f"{self.deg:.2f}° count"
        )

    def as_result(self) -> dict[str, Any]:
        """Return it in the form of results."""
        values = {"mm": self.mm, "deg": self.deg, "noise_mm": self.noise_mm, "noise_deg": self.noise_deg}
        return {"text": self.text, **values}


def noise(frames: Sequence[Transform]) -> tuple[float, float]:
    """Return the noise of a tool at rest: the rms scatter of its position, mm, and of its rotation, deg.

    It is the scatter of the means of `GROUPS` groups of successive frames about a straight line over time: a group
    averages the noise of single frames, as the whole measurement does, but keeps fluctuations that are slower than its
    own duration; and the line is a body that moves on evenly, which is no noise. With so few groups their own number of
    degrees of freedom counts. There is no noise to be seen in fewer frames than groups.

    Args:
        frames: Poses in the order of their frames.
    """
    size = len(frames) // GROUPS
    if size == 0:
        return 0.0, 0.0
    means = [mean_transform(frames[size * group : size * (group + 1)]) for group in range(GROUPS)]
    turns = np.array([(means[0].inverse() @ mean).rotvec for mean in means])
    return (
        _scatter(np.array([mean.translation for mean in means])) * 1000.0,
        math.degrees(_scatter(turns)),
    )


def _scatter(points: Floats) -> float:
    """Return the rms distance of points, (GROUPS, 3), from the line that fits them best over equal times."""
    time = np.arange(len(points)) - (len(points) - 1) / 2.0
    slope = time @ points / (time @ time)
    rest = points - points.mean(axis=0) - time[:, None] * slope
    return float(np.sqrt((rest**2).sum() / (len(points) - 2)))
