"""Bodies for contact with the flat face of a tool: their depth beyond it."""

from __future__ import annotations

from collections.abc import Iterable
from math import copysign
from operator import mul
from typing import NamedTuple, Protocol

import numpy as np

from pcmrs.spatial import Floats
from pcmrs_sim.shape import Capsule

SPACING = 0.002
"""Distance between the spheres that approximate a capsule, m. At a radius of 14 mm, its side is exact to 0.04 mm."""


class Touch(NamedTuple):
    """Contact of a body with a face.

    Attributes:
        depth: Depth of the body beyond the face, m; positive.
        point: Deepest point, in the image, m, (3,).
    """

    depth: float
    point: Floats


class ContactSolid(Protocol):
    """A body in the image frame.

    Attributes:
        centre: Centre of a sphere that encloses the body, in the image, m, (3,).
        bounding_radius: Radius of that sphere, m.
    """

    centre: Floats
    bounding_radius: float

    def touch(self, origin: Floats, axis: Floats, radius: float) -> Touch | None:
        """Return the deepest contact with a round face; None if the body does not touch it.

        Args:
            origin: Centre of the face, in the image, m, (3,).
            axis: Unit normal of the face, away from the body, in the image, (3,).
            radius: Radius of the face, m.
        """


class Superellipsoid:
    """All points with ``sum |(x_i - c_i) / a_i|^e <= 1``.

    Its support function is the dual norm of the direction: ``h(n) = (sum |a_i n_i|^q)^(1/q)``, ``1/e + 1/q = 1``. It is
    computed in plain floats, which are faster than arrays of three numbers: contact is computed at each physics step.

    Args:
        centre: c, in the image, m, (3,).
        semi_axes: a, m, (3,).
        exponent: e, at least 2.
    """

    def __init__(self, centre: Floats, semi_axes: Floats, exponent: float) -> None:
        self.centre = centre
        self.bounding_radius = float(semi_axes.max()) * 3 ** (0.5 - 1 / exponent)
        self._semi_axes = semi_axes.tolist()
        self._dual = exponent / (exponent - 1)

    def touch(self, origin: Floats, axis: Floats, radius: float) -> Touch | None:
        """See `ContactSolid`. A body whose deepest point is beside the face does not touch it.

        Args:
            origin: Centre of the face, in the image, m, (3,).
            axis: Unit normal of the face, away from the body, in the image, (3,).
            radius: Radius of the face, m.
        """
        along, origin_in_image, centre, dual = axis.tolist(), origin.tolist(), self.centre.tolist(), self._dual
        weights = [a * n for a, n in zip(self._semi_axes, along, strict=True)]
        height = sum(abs(weight) ** dual for weight in weights) ** (1 / dual)
        point = [
            c + copysign(a * (abs(weight) / height) ** (dual - 1), weight)
            for c, a, weight in zip(centre, self._semi_axes, weights, strict=True)
        ]
        offset = [p - o for p, o in zip(point, origin_in_image, strict=True)]
        depth = sum(map(mul, offset, along))
        lateral_squared = sum(map(mul, offset, offset)) - depth**2
        return Touch(depth, np.array(point)) if depth > 0.0 and lateral_squared <= radius**2 else None


class CapsuleUnion:
    """A union of capsules, each approximated by a row of spheres.

    Args:
        capsules: At least one capsule, in the image, m.
    """

    def __init__(self, capsules: Iterable[Capsule]) -> None:
        rows = [(_sphere_centres(capsule), capsule.radius) for capsule in capsules]
        self._centres = np.concatenate([centres for centres, _ in rows])
        self._radii = np.concatenate([np.full(len(centres), radius) for centres, radius in rows])
        self._squares = np.sum(self._centres**2, axis=1)
        self.centre: Floats = (self._centres.min(axis=0) + self._centres.max(axis=0)) / 2
        self.bounding_radius = float((np.linalg.norm(self._centres - self.centre, axis=1) + self._radii).max())

    def touch(self, origin: Floats, axis: Floats, radius: float) -> Touch | None:
        """See `ContactSolid`. Only the part of a sphere in front of the face counts: a narrow tool fits between parts.

        Args:
            origin: Centre of the face, in the image, m, (3,).
            axis: Unit normal of the face, away from the body, in the image, (3,).
            radius: Radius of the face, m.
        """
        # One product for both projections, and expanded squares: contact is computed at each physics step.
        heights, along = (self._centres @ np.stack((axis, origin), axis=1)).T
        heights = heights - origin @ axis
        lateral = np.sqrt(np.maximum(self._squares - 2 * along + origin @ origin - heights**2, 0.0))
        # The highest point of a sphere is above its centre, or above the rim of the face if the centre is beside it.
        squared = self._radii**2 - np.maximum(lateral - radius, 0.0) ** 2
        depths = np.where(squared > 0.0, heights + np.sqrt(np.maximum(squared, 0.0)), -np.inf)
        highest = int(depths.argmax())
        if depths[highest] <= 0.0:
            return None
        across = self._centres[highest] - origin - heights[highest] * axis
        inward = min(1.0, radius / lateral[highest]) if lateral[highest] > 0.0 else 0.0
        return Touch(float(depths[highest]), origin + depths[highest] * axis + inward * across)


def _sphere_centres(capsule: Capsule) -> Floats:
    """Return the centres of the spheres that approximate a capsule, m, (k, 3)."""
    length = float(np.linalg.norm(capsule.end - capsule.start))
    return np.linspace(capsule.start, capsule.end, 1 + int(np.ceil(length / SPACING)))
