"""Shapes whose distances are computed by coal, each with its pose in the frame that carries it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import numpy.typing as npt
import pinocchio
from scipy.spatial import ConvexHull, QhullError

from pcmrs.errors import GeometryError
from pcmrs.spatial import Floats, Transform

_Z = np.array((0.0, 0.0, 1.0))


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex shape.

    Attributes:
        geometry: As coal has it, about its own origin.
        pose: Where that is in the frame that carries it, as Pinocchio has it.
    """

    geometry: Any
    pose: Any


def capsule(start: npt.ArrayLike, end: npt.ArrayLike, radius: float) -> Solid:
    """All points within `radius` of the line from `start` to `end`, (3,), m; a ball where these are the same."""
    a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    return Solid(coal.Capsule(radius, float(np.linalg.norm(b - a))), pose_between(a, b))


def cylinder(radius: float, half_length: float, middle: float = 0.0) -> Solid:
    """A cylinder about the z axis, its middle `middle` along it; m."""
    return Solid(coal.Cylinder(radius, 2.0 * half_length), pinocchio.SE3(np.eye(3), np.array((0.0, 0.0, middle))))


def box(size: npt.ArrayLike, frame_from_box: Transform) -> Solid:
    """A box with edges `size` along its axes, m, (3,); its origin is its middle."""
    return Solid(coal.Box(np.asarray(size, dtype=float)), se3(frame_from_box))


def hull(points: npt.ArrayLike) -> Solid:
    """The convex hull of points (N, 3), m.

    Raises:
        GeometryError: There is none: fewer than four points, or all of them in a plane.
    """
    points = np.asarray(points, dtype=float)
    try:
        found = ConvexHull(points)
    except (QhullError, ValueError):
        text = f"{len(points)} points have no convex hull that encloses anything; give a closed surface."
        raise GeometryError(text, points=len(points)) from None
    corners, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    number = {int(vertex): index for index, vertex in enumerate(found.vertices)}
    for vertex in found.vertices:
        corners.append(points[vertex])
    for face in found.simplices:
        triangles.append(coal.Triangle(*(number[int(vertex)] for vertex in face)))
    return Solid(coal.Convex(corners, triangles), pinocchio.SE3.Identity())


def pose_between(start: Floats, end: Floats) -> Any:
    """A frame in the middle of the line from `start` to `end`, (3,), with z along it; as Pinocchio has it."""
    same = bool(np.all(start == end))
    turn = pinocchio.Quaternion.Identity() if same else pinocchio.Quaternion.FromTwoVectors(_Z, end - start)
    return pinocchio.SE3(turn, (start + end) / 2.0)


def se3(transform: Transform) -> Any:
    """The same as Pinocchio has it."""
    return pinocchio.SE3(transform.rotation, transform.translation)
