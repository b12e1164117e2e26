"""Rigid bodies: mass, centre and inertia, seen from another frame and merged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcmrs.spatial import Floats, Transform


@dataclass(frozen=True, eq=False)
class Body:
    """Mass properties in some frame.

    Attributes:
        mass: kg.
        com: Centre of mass, m, (3,).
        inertia: About the centre of mass, along the axes of the frame, kg m^2, (3, 3).
    """

    mass: float
    com: Floats
    inertia: Floats

    def seen_from(self, frame_from_own: Transform) -> Body:
        """The same body in another frame."""
        turn = frame_from_own.rotation
        return Body(self.mass, frame_from_own @ self.com, turn @ self.inertia @ turn.T)


def merged(bodies: Sequence[Body]) -> Body:
    """Bodies of one frame that are fixed to each other as one, by the parallel axis theorem; some mass is needed."""
    mass = sum(body.mass for body in bodies)
    com = sum((body.mass * body.com for body in bodies), np.zeros(3)) / mass
    inertia = sum((body.inertia + _of_point(body.mass, body.com - com) for body in bodies), np.zeros((3, 3)))
    return Body(mass, com, inertia)


def _of_point(mass: float, offset: Floats) -> Floats:
    """Inertia of a point mass at an offset, kg m^2, (3, 3)."""
    inertia: Floats = mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return inertia
