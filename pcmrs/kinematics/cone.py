"""Virtual fixture of an approach: near the target the tool point stays inside a cone around the planned axis."""

from __future__ import annotations

from dataclasses import dataclass
from math import tan

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats, Transform


@dataclass(frozen=True)
class ApproachCone:
    """A cone that is cut off at the target and opens along the target's +z axis, with a depth limit below the target.

    It applies within `height` of the target; farther away every tool point is allowed. After L. B. Rosenberg, Virtual
    Fixtures: Perceptual Tools for Telerobotic Manipulation, IEEE VRAIS 1993, used here as a region that must not be
        left.

    Attributes:
        half_angle: Angle between the axis and the surface of the cone, rad.
        height: Distance from the target within which the cone applies, m.
        radius: Radius of the cone at the target, m.
        depth: Distance below the target that the tool point may reach, m.
    """

    half_angle: float
    height: float
    radius: float
    depth: float

    def excess(self, base_from_target: Transform, points: npt.ArrayLike) -> Floats:
        """Return the distances by which tool points are beside the cone or too deep.

        Args:
            base_from_target: Pose of the target in the robot's base.
            points: Tool points in the robot's base, m, (N, 3).

        Returns:
            Distances outside the cone, m, (N,); 0 inside it and beyond its height.
        """
        x, y, z = (base_from_target.inverse() @ np.atleast_2d(np.asarray(points, dtype=float))).T
        lateral = np.hypot(x, y) - self.radius - np.maximum(z, 0.0) * tan(self.half_angle)
        outside = np.maximum(np.maximum(lateral, -z - self.depth), 0.0)
        return np.where(np.sqrt(x * x + y * y + z * z) < self.height, outside, 0.0)
