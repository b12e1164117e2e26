"""The virtual fixture of an approach: near the target the tool point stays inside a cone around the planned axis."""

from __future__ import annotations

from dataclasses import dataclass
from math import tan

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats, Transform


@dataclass(frozen=True)
class ApproachCone:
    """A cone cut off at the target, and how deep below it the tool point may be; it opens along +z of the target.

    Holds within `height` of the target; farther away anything is allowed. After L. B. Rosenberg, Virtual Fixtures:
    Perceptual Tools for Telerobotic Manipulation, IEEE VRAIS 1993, as a region that must not be left.

    Attributes:
        half_angle: Between its axis and its surface, rad.
        height: Distance from the target within which it holds, m.
        radius: At the target, m.
        depth: Below the target, m.
    """

    half_angle: float
    height: float
    radius: float
    depth: float

    def excess(self, base_from_target: Transform, points: npt.ArrayLike) -> Floats:
        """How far tool points (N, 3) in the base are outside, m, (N,): beside the cone or too deep; 0 inside."""
        x, y, z = (base_from_target.inverse() @ np.atleast_2d(np.asarray(points, dtype=float))).T
        beside = np.hypot(x, y) - self.radius - np.maximum(z, 0.0) * tan(self.half_angle)
        outside = np.maximum(np.maximum(beside, -z - self.depth), 0.0)
        return np.where(np.sqrt(x * x + y * y + z * z) < self.height, outside, 0.0)
