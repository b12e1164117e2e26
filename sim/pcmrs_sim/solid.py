"""Bodies as a flat face of a tool meets them: how far they reach beyond it."""

from __future__ import annotations

from collections.abc import Iterable
from math import copysign
from operator import mul
from typing import NamedTuple, Protocol

import numpy as np

from pcmrs.spatial import Floats
from pcmrs_sim.shape import Capsule

SPACING = 0.002
"""Between the balls that stand for a capsule, m: its side is then true to 0.04 mm at a radius of 14 mm."""


class Touch(NamedTuple):
    """How far a body reaches beyond a face, m, and where it does, in the image, m, (3,)."""

    depth: float
    point: Floats


class ContactSolid(Protocol):
    """A body in the image frame.

    Attributes:
        centre: Of a sphere around all of it, m, (3,).
        reach: Radius of that sphere, m.
    """

    centre: Floats
    reach: float

    def touch(self, origin: Floats, axis: Floats, radius: float) -> Touch | None:
        """Where the body reaches farthest along `axis` beyond a round face of `radius` m at `origin`, (3,).

        None where it does not reach the face.
        """


class Superellipsoid:
    """All points with ``sum |(x_i - c_i) / a_i|^e <= 1``.

    In plain floats: a tool in touch asks at every step.

    Its support function is the dual norm of the direction: ``h(n) = (sum |a_i n_i|^q)^(1/q)``, ``1/e + 1/q = 1``.

    Args:
        centre: c, m, (3,).
        semi_axes: a, m, (3,).
        exponent: e, at least 2.
    """

    def __init__(self, centre: Floats, semi_axes: Floats, exponent: float) -> None:
        self.centre = centre
        self.reach = float(semi_axes.max()) * 3 ** (0.5 - 1 / exponent)
        self._semi_axes = semi_axes.tolist()
        self._dual = exponent / (exponent - 1)

    def touch(self, origin: Floats, axis: Floats, radius: float) -> Touch | None:
        """As of `ContactSolid`; a body whose farthest point lies beside the face does not touch it."""
        along, origin_in_image, centre, dual = axis.tolist(), origin.tolist(), self.centre.tolist(), self._dual
        weights = [a * n for a, n in zip(self._semi_axes, along, strict=True)]
        height = sum(abs(weight) ** dual for weight in weights) ** (1 / dual)
        point = [
            c + copysign(a * (abs(weight) / height) ** (dual - 1), weight)
            for c, a, weight in zip(centre, self._semi_axes, weights, strict=True)
        ]
        offset = [p - o for p, o in zip(point, origin_in_image, strict=True)]
        depth = sum(map(mul, offset, along))
        beside_squared = sum(map(mul, offset, offset)) - depth**2
        return Touch(depth, np.array(point)) if depth > 0.0 and beside_squared <= radius**2 else None


class Balls:
    """A union of capsules, as rows of balls.

    Args:
        capsules: At least one.
    """

    def __init__(self, capsules: Iterable[Capsule]) -> None:
        rows = [(_along(capsule), capsule.radius) for capsule in capsules]
        self._centres = np.concatenate([centres for centres, _ in rows])
        self._radii = np.concatenate([np.full(len(centres), radius) for centres, radius in rows])
        self._squares = np.sum(self._centres**2, axis=1)
        self.centre: Floats = (self._centres.min(axis=0) + self._centres.max(axis=0)) / 2
        self.reach = float((np.linalg.norm(self._centres - self.centre, axis=1) + self._radii).max())

    def touch(self, origin: Floats, axis: Floats, radius: float) -> Touch | None:
        """See `ContactSolid`. Only the part of a ball before the face counts, so that a narrow tool fits between."""
        heights, along = (self._centres @ np.stack((axis, origin), axis=1)).T
        heights = heights - origin @ axis
        beside = np.sqrt(np.maximum(self._squares - 2 * along + origin @ origin - heights**2, 0.0))
        squared = self._radii**2 - np.maximum(beside - radius, 0.0) ** 2
        depths = np.where(squared > 0.0, heights + np.sqrt(np.maximum(squared, 0.0)), -np.inf)
        highest = int(depths.argmax())
        if depths[highest] <= 0.0:
            return None
        across = self._centres[highest] - origin - heights[highest] * axis
        inward = min(1.0, radius / beside[highest]) if beside[highest] > 0.0 else 0.0
        return Touch(float(depths[highest]), origin + depths[highest] * axis + inward * across)


def _along(capsule: Capsule) -> Floats:
    length = float(np.linalg.norm(capsule.end - capsule.start))
    return np.linspace(capsule.start, capsule.end, 1 + int(np.ceil(length / SPACING)))
