"""A parametric right proximal femur: capsules and balls with four landmarks, in the image frame (RAS, m).

Its proportions are those of an adult: neck-shaft angle 127°, anteversion 12°, head of 48 mm.
"""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats, Transform
from pcmrs_sim.phantom import Phantom, PhantomLandmark
from pcmrs_sim.shape import Capsule
from pcmrs_sim.solid import Balls

BASE = np.array([0.085, 0.012, -0.020])
"""Where the axes of neck and shaft meet, in the image, m: the right hip beside the middle of the scanner."""
NECK_RISE = radians(37.0)
ANTEVERSION = radians(12.0)
NECK_AXIS = np.array([-cos(NECK_RISE) * cos(ANTEVERSION), cos(NECK_RISE) * sin(ANTEVERSION), sin(NECK_RISE)])
"""From the shaft to the head: medial, superior and a little anterior."""
NECK_LENGTH = 0.055
HEAD_CENTRE: Floats = BASE + NECK_LENGTH * NECK_AXIS
GUIDE_MASS = 0.8  # kg: sleeve and handle
GUIDE_RADIUS = 0.006  # m
GUIDE_LENGTH = 0.12  # m
_TRACE_FROM = 0.3  # m; outside of the bone in every direction
_ON_SURFACE = 1e-12  # m


def from_base(x: float, y: float, z: float) -> Floats:
    """A point given from `BASE`, in the image, m, (3,)."""
    point: Floats = BASE + np.array([x, y, z])
    return point


BONE = (
    Capsule(BASE, HEAD_CENTRE, 0.0165),  # neck
    Capsule(HEAD_CENTRE, HEAD_CENTRE, 0.024),  # head
    Capsule(from_base(0.018, -0.006, -0.015), from_base(0.020, -0.010, 0.022), 0.016),  # greater trochanter
    Capsule(BASE, from_base(0.005, 0.0, -0.030), 0.022),  # between the trochanters
    Capsule(from_base(0.0, 0.0, -0.020), from_base(0.0, 0.0, -0.140), 0.0145),  # shaft, cut off
    Capsule(from_base(-0.016, -0.016, -0.038), from_base(-0.016, -0.016, -0.038), 0.009),  # lesser trochanter
)


def distances(points: Floats) -> Floats:
    """Distances of points (..., 3) of the image from the bone's surface, m, (...,); negative inside."""
    found: Floats = np.min([part.distance(points) for part in BONE], axis=0)
    return found


def distance(point: Floats) -> float:
    """The same of one point, (3,)."""
    return float(distances(point))


def surface_point(origin: npt.ArrayLike, direction: npt.ArrayLike) -> Floats:
    """Where a ray from inside the bone leaves it for good, in the image, m, (3,).

    By sphere tracing from outside (Hart, Sphere Tracing, The Visual Computer 1996).
    """
    origin, ray = np.asarray(origin, dtype=float), np.asarray(direction, dtype=float)
    ray = ray / np.linalg.norm(ray)
    along = _TRACE_FROM
    while (gap := distance(origin + along * ray)) > _ON_SURFACE:
        along -= gap
    point: Floats = origin + along * ray
    return point


LANDMARKS = (
    PhantomLandmark("greater_trochanter", surface_point(from_base(0.020, -0.010, 0.0), (0.4, -0.2, 1.0))),
    PhantomLandmark("lesser_trochanter", surface_point(from_base(-0.016, -0.016, -0.038), (-0.8, -0.6, 0.0))),
    PhantomLandmark("femoral_head", surface_point(HEAD_CENTRE, (-1.0, 0.3, 0.5))),
    PhantomLandmark("lateral_shaft", surface_point(from_base(0.0, 0.0, -0.120), (1.0, 0.4, 0.0))),
)


def _world_from_image() -> Transform:
    """Lateral side up and shaft towards the robot, leant so far that a guide on the neck stands about upright."""
    turned = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
    leant = Transform.from_rotvec((0.60, 0.0, 0.10), (0.0, radians(20.0), 0.0))
    return leant @ Transform(turned, -turned @ BASE)


def _body_ref_from_image() -> Transform:
    """The marker body stands off the lateral side of the shaft, anterior of it."""
    return Transform.from_quat_wxyz(from_base(0.030, 0.050, -0.130), (0.5, -0.5, -0.5, -0.5)).inverse()


_SLEEVE = Capsule(np.array([0.0, 0.0, GUIDE_RADIUS]), np.array([0.0, 0.0, GUIDE_LENGTH]), GUIDE_RADIUS)

FEMUR = Phantom(
    inside=BASE,
    landmarks=LANDMARKS,
    body=tuple(part.shape() for part in BONE),
    solid=Balls(BONE),
    tool=(_SLEEVE.shape(GUIDE_MASS),),
    tool_radius=GUIDE_RADIUS,
    world_from_image=_world_from_image(),
    body_ref_from_image=_body_ref_from_image(),
)
"""A femur clamped to the bench, and a drill guide on the robot."""
