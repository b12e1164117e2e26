"""A parametric right proximal femur: capsules with four landmarks, in the image frame (RAS, m).

Its proportions are those of an adult: neck-shaft angle 127°, anteversion 12°, diameter of the head 48 mm.
"""

from __future__ import annotations

from math import cos, radians, sin

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats, Transform
from pcmrs_sim.phantom import Phantom, PhantomLandmark
from pcmrs_sim.shape import Capsule
from pcmrs_sim.solid import CapsuleUnion

BASE = np.array([0.085, 0.012, -0.020])
"""Intersection of the axes of neck and shaft, in the image, m, (3,): the right hip is beside the scanner's centre."""
NECK_RISE = radians(37.0)
"""Angle of the neck above the horizontal, rad: the neck-shaft angle minus 90°."""
ANTEVERSION = radians(12.0)
"""Angle of the neck to the front, rad."""
NECK_AXIS = np.array([-cos(NECK_RISE) * cos(ANTEVERSION), cos(NECK_RISE) * sin(ANTEVERSION), sin(NECK_RISE)])
"""Direction from the shaft to the head, (3,): medial, superior and slightly anterior."""
NECK_LENGTH = 0.055
"""Distance from `BASE` to the centre of the head, m."""
HEAD_CENTRE: Floats = BASE + NECK_LENGTH * NECK_AXIS
"""Centre of the femoral head, in the image, m, (3,)."""
GUIDE_MASS = 0.8  # kg: sleeve and handle
GUIDE_RADIUS = 0.006  # m
GUIDE_LENGTH = 0.12  # m
_TRACE_START = 0.3  # m from a point inside: outside the bone in each direction
_SURFACE_TOLERANCE = 1e-12  # m


def from_base(x: float, y: float, z: float) -> Floats:
    """Return a point in the image, m, (3,).

    Args:
        x: Offset to the right of `BASE`, m.
        y: Offset to the front, m.
        z: Offset upwards, m.
    """
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
    """Return the distances of points (..., 3) in the image from the bone's surface, m, (...,); negative inside."""
    nearest: Floats = np.min([part.distance(points) for part in BONE], axis=0)
    return nearest


def distance(point: Floats) -> float:
    """Return the distance of a point in the image, m, (3,), from the bone's surface, m; negative inside."""
    return float(distances(point))


def surface_point(origin: npt.ArrayLike, direction: npt.ArrayLike) -> Floats:
    """Return the last intersection of a ray with the bone's surface, in the image, m, (3,).

    It is found by sphere tracing from outside (Hart, Sphere Tracing, The Visual Computer 1996).

    Args:
        origin: A point inside the bone, in the image, m, (3,).
        direction: Direction of the ray, of any length, (3,).
    """
    origin, ray = np.asarray(origin, dtype=float), np.asarray(direction, dtype=float)
    ray = ray / np.linalg.norm(ray)
    along = _TRACE_START
    while (clearance := distance(origin + along * ray)) > _SURFACE_TOLERANCE:
        along -= clearance
    point: Floats = origin + along * ray
    return point


LANDMARKS = (
    PhantomLandmark("greater_trochanter", surface_point(from_base(0.020, -0.010, 0.0), (0.4, -0.2, 1.0))),
    PhantomLandmark("lesser_trochanter", surface_point(from_base(-0.016, -0.016, -0.038), (-0.8, -0.6, 0.0))),
    PhantomLandmark("femoral_head", surface_point(HEAD_CENTRE, (-1.0, 0.3, 0.5))),
    PhantomLandmark("lateral_shaft", surface_point(from_base(0.0, 0.0, -0.120), (1.0, 0.4, 0.0))),
)


def _world_from_image() -> Transform:
    """Return the pose with the lateral side up and the shaft towards the robot.

    It is tilted so that a guide on the neck is about vertical.
    """
    lateral_up = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
    tilt = Transform.from_rotvec((0.60, 0.0, 0.10), (0.0, radians(20.0), 0.0))
    return tilt @ Transform(lateral_up, -lateral_up @ BASE)


def _body_ref_from_image() -> Transform:
    """Return the pose of the image in a marker body that is lateral and anterior of the shaft."""
    return Transform.from_quat_wxyz(from_base(0.030, 0.050, -0.130), (0.5, -0.5, -0.5, -0.5)).inverse()


_SLEEVE = Capsule(np.array([0.0, 0.0, GUIDE_RADIUS]), np.array([0.0, 0.0, GUIDE_LENGTH]), GUIDE_RADIUS)

FEMUR = Phantom(
    inside=BASE,
    landmarks=LANDMARKS,
    solid=CapsuleUnion(BONE),
    tool=(_SLEEVE.shape(GUIDE_MASS),),
    tool_radius=GUIDE_RADIUS,
    world_from_image=_world_from_image(),
    body_ref_from_image=_body_ref_from_image(),
)
"""A femur clamped to the bench, and a drill guide on the robot."""
