"""A parametric head: a superellipsoid scalp with six landmarks, in the image frame (RAS, m)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats, Transform
from pcmrs_sim.phantom import Phantom, PhantomLandmark
from pcmrs_sim.shape import Shape
from pcmrs_sim.solid import Superellipsoid

CENTRE = np.array([0.004, -0.012, 0.035])
"""Centre of the head in the image, m, (3,): scanners do not centre heads."""
SEMI_AXES = np.array([0.078, 0.098, 0.108])
"""Half width (right), half length (anterior) and half height (superior) of the head, m, (3,)."""
EXPONENT = 2.3
"""Exponent of the superellipsoid. An ellipsoid has 2; a head is slightly more square."""
COIL_MASS = 1.0  # kg: a figure-of-eight coil without its cable
COIL_RADIUS = 0.05  # m
COIL_HALF_THICKNESS = 0.01  # m
COIL_CENTRE = Transform(np.eye(3), np.array([0.0, 0.0, COIL_HALF_THICKNESS]))  # the origin is on the face


def surface_point(direction: npt.ArrayLike) -> Floats:
    """Return the point of the surface in a direction from the centre of the head, in the image, m, (3,).

    From ``sum |x_i / a_i|^e = 1`` (Barr, Superquadrics, IEEE CG&A 1981).

    Args:
        direction: Direction of any length, (3,).
    """
    ray = np.asarray(direction, dtype=float)
    scale = np.sum(np.abs(ray / SEMI_AXES) ** EXPONENT) ** (-1 / EXPONENT)
    point: Floats = CENTRE + scale * ray
    return point


def level(points: Floats) -> Floats:
    """Return the implicit function at points (..., 3) in the image, (...,): negative inside, 0 on the surface."""
    powers = np.sum(np.abs((points - CENTRE) / SEMI_AXES) ** EXPONENT, axis=-1)
    levels: Floats = powers ** (1 / EXPONENT) - 1.0
    return levels


def outward_normal(point: npt.ArrayLike) -> Floats:
    """Return the unit normal at a point of the surface, in the image, (3,): the gradient of the implicit function."""
    offset = (np.asarray(point, dtype=float) - CENTRE) / SEMI_AXES
    gradient = np.sign(offset) * np.abs(offset) ** (EXPONENT - 1) / SEMI_AXES
    normal: Floats = gradient / np.linalg.norm(gradient)
    return normal


def landmark(name: str, direction: tuple[float, float, float], height: float = 0.0) -> PhantomLandmark:
    """Return a landmark on or above the scalp.

    Args:
        name: Name of the landmark.
        direction: Direction from the centre of the head, of any length.
        height: Height above the scalp along its normal, m.
    """
    point = surface_point(direction)
    return PhantomLandmark(name, point + height * outward_normal(point))


LANDMARKS = (
    landmark("nasion", (0.0, 1.0, 0.05)),
    landmark("nose_tip", (0.0, 1.0, -0.40), height=0.022),
    landmark("left_outer_canthus", (-0.52, 0.85, 0.0)),
    landmark("right_outer_canthus", (0.52, 0.85, 0.0)),
    landmark("left_tragus", (-1.0, 0.05, -0.20), height=0.005),
    landmark("right_tragus", (1.0, 0.05, -0.20), height=0.005),
)

HEAD = Phantom(
    inside=CENTRE,
    landmarks=LANDMARKS,
    solid=Superellipsoid(CENTRE, SEMI_AXES, EXPONENT),
    tool=(Shape("cylinder", COIL_CENTRE, (COIL_RADIUS, COIL_HALF_THICKNESS), COIL_MASS),),
    tool_radius=COIL_RADIUS,
    # Upright, 0.45 m in front of the base, facing away from it.
    world_from_image=Transform.from_quat_wxyz((0.462, 0.004, -0.015), (0.70710678, 0.0, 0.0, -0.70710678)),
    # On the forehead.
    body_ref_from_image=Transform.from_quat_wxyz((-0.10, -0.01, -0.11), (0.5, 0.5, 0.5, 0.5)),
)
"""A head on a stand, and a stimulation coil on the robot."""
