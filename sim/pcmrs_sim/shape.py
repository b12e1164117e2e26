"""Primitive shapes of the scene: the tool of the simulated arm, and the body in front of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats, Transform


@dataclass(frozen=True, eq=False)
class Shape:
    """One primitive.

    Attributes:
        kind: Kind of primitive. The axis of a cylinder or capsule is z.
        pose: Pose of its centre, in the frame of the body that it belongs to.
        size: Semi-axes of an ellipsoid; radius and half length of a cylinder, or of a capsule without its caps; m.
        mass: Mass, kg; used on moving bodies only.
    """

    kind: Literal["ellipsoid", "cylinder", "capsule"]
    pose: Transform
    size: tuple[float, ...]
    mass: float = 0.0


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within a distance of a line; a sphere if the line has no length.

    Attributes:
        start: Start of the line, m, (3,).
        end: End of the line, m, (3,).
        radius: The distance, m.
    """

    start: Floats
    end: Floats
    radius: float

    def distance(self, points: Floats) -> Floats:
        """Return the distances of points (..., 3) from the surface, m, (...,); negative inside."""
        line = self.end - self.start
        squared = max(float(line @ line), np.finfo(float).tiny)  # the line of a sphere has no length
        along = np.asarray(np.clip((points - self.start) @ line / squared, 0.0, 1.0))
        distances: Floats = np.linalg.norm(points - self.start - along[..., None] * line, axis=-1) - self.radius
        return distances

    def shape(self, mass: float = 0.0) -> Shape:
        """Return the primitive of this capsule, with a mass, kg."""
        line, middle = self.end - self.start, (self.start + self.end) / 2
        if not line.any():
            return Shape("ellipsoid", Transform(np.eye(3), middle), (self.radius,) * 3, mass)
        size = (self.radius, float(np.linalg.norm(line)) / 2)
        return Shape("capsule", Transform(rotation_with_z(line), middle), size, mass)


def rotation_with_z(direction: npt.ArrayLike) -> Floats:
    """Return a rotation matrix, (3, 3), whose third column points along a direction of any length, (3,)."""
    z = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(z, x), z))
