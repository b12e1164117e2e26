"""Solid shapes of the scene: what the simulated arm carries, and what stands before it."""

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
        kind: Its form; a cylinder and a capsule have their axis along z.
        pose: Of its centre.
        size: Semi-axes of an ellipsoid; radius and half length of the others, of a capsule without its caps; m.
        mass: kg; means something on what moves only.
    """

    kind: Literal["ellipsoid", "cylinder", "capsule"]
    pose: Transform
    size: tuple[float, ...]
    mass: float = 0.0


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within `radius` of the line from `start` to `end`, m; a ball where these are the same."""

    start: Floats
    end: Floats
    radius: float

    def distance(self, points: Floats) -> Floats:
        """Distances of points (..., 3) from the surface, m, (...,); negative inside."""
        line = self.end - self.start
        squared = max(float(line @ line), np.finfo(float).tiny)  # a ball's line has no length
        along = np.asarray(np.clip((points - self.start) @ line / squared, 0.0, 1.0))
        distances: Floats = np.linalg.norm(points - self.start - along[..., None] * line, axis=-1) - self.radius
        return distances

    def shape(self, mass: float = 0.0) -> Shape:
        """The same for the scene."""
        line, middle = self.end - self.start, (self.start + self.end) / 2
        if not line.any():
            return Shape("ellipsoid", Transform(np.eye(3), middle), (self.radius,) * 3, mass)
        size = (self.radius, float(np.linalg.norm(line)) / 2)
        return Shape("capsule", Transform(rotation_with_z(line), middle), size, mass)


def rotation_with_z(direction: npt.ArrayLike) -> Floats:
    """A rotation matrix whose third column points along `direction`, (3, 3)."""
    z = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.column_stack((x, np.cross(z, x), z))
