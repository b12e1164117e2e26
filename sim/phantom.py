"""A parametric head: a superellipsoid scalp with six landmarks, in the image frame (RAS, m)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats

CENTRE = np.array([0.004, -0.012, 0.035])
"""Centre of the head in the image, m: scanners do not centre heads."""
SEMI_AXES = np.array([0.078, 0.098, 0.108])
"""Half width (right), half length (anterior) and half height (superior) of the head, m."""
EXPONENT = 2.3
"""Exponent of the superellipsoid: 2 is an ellipsoid, a head is a little more square."""


@dataclass(frozen=True)
class Landmark:
    """An anatomical point of the head.

    Attributes:
        name: As a planner shows it.
        direction: From the centre of the head, RAS; its length does not matter.
        height: Above the scalp's surface along its normal, m.
    """

    name: str
    direction: tuple[float, float, float]
    height: float = 0.0


LANDMARKS = (
    Landmark("nasion", (0.0, 1.0, 0.05)),
    Landmark("nose_tip", (0.0, 1.0, -0.40), height=0.022),
    Landmark("left_outer_canthus", (-0.52, 0.85, 0.0)),
    Landmark("right_outer_canthus", (0.52, 0.85, 0.0)),
    Landmark("left_tragus", (-1.0, 0.05, -0.20), height=0.005),
    Landmark("right_tragus", (1.0, 0.05, -0.20), height=0.005),
)


def surface_point(direction: npt.ArrayLike) -> Floats:
    """Where a ray from the centre of the head meets the surface, in the image, m, (3,).

    From ``sum |x_i / a_i|^e = 1`` (Barr, Superquadrics, IEEE CG&A 1981).
    """
    ray = np.asarray(direction, dtype=float)
    scale = np.sum(np.abs(ray / SEMI_AXES) ** EXPONENT) ** (-1 / EXPONENT)
    point: Floats = CENTRE + scale * ray
    return point


def outward_normal(point: npt.ArrayLike) -> Floats:
    """Unit normal of the surface at a point of it, in the image, (3,): the gradient of the implicit function."""
    offset = (np.asarray(point, dtype=float) - CENTRE) / SEMI_AXES
    gradient = np.sign(offset) * np.abs(offset) ** (EXPONENT - 1) / SEMI_AXES
    normal: Floats = gradient / np.linalg.norm(gradient)
    return normal


def landmark_position(landmark: Landmark) -> Floats:
    """The landmark in the image, m, (3,)."""
    point = surface_point(landmark.direction)
    position: Floats = point + landmark.height * outward_normal(point)
    return position
