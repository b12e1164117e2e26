"""Convex shapes whose distances coal computes, each with its pose in the frame that carries it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import numpy.typing as npt
import pinocchio

from pcmrs.errors import GeometryError
from pcmrs.spatial import Floats, Transform

_Z = np.array((0.0, 0.0, 1.0))
_NO_TURN = pinocchio.Quaternion.Identity()
FLAT = 1e-7
"""Points whose least extent is this share of their greatest lie in a plane."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A convex shape.

    Attributes:
        geometry: coal's geometry about its own origin.
        pose: Pose of that origin in the frame that carries the shape, a `pinocchio.SE3`.
    """

    geometry: Any
    pose: Any


def capsule(start: npt.ArrayLike, end: npt.ArrayLike, radius: float) -> Solid:
    """Return the capsule of all points within a distance of a line segment; a sphere if both ends are equal.

    Args:
        start: First end of the segment, m, (3,).
        end: Second end of the segment, m, (3,).
        radius: Distance from the segment, m.
    """
    a, b = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    return Solid(coal.Capsule(radius, float(np.linalg.norm(b - a))), pose_between(a, b))


def cylinder(radius: float, half_length: float, middle: float = 0.0) -> Solid:
    """Return a cylinder about the z axis.

    Args:
        radius: Radius, m.
        half_length: Half of its length along z, m.
        middle: z coordinate of its middle, m.
    """
    return Solid(coal.Cylinder(radius, 2.0 * half_length), pinocchio.SE3(np.eye(3), np.array((0.0, 0.0, middle))))


def box(size: npt.ArrayLike, frame_from_box: Transform) -> Solid:
    """Return a box with its origin in its middle.

    Args:
        size: Lengths of its edges along its own x, y and z axes, m, (3,).
        frame_from_box: Pose of the box in the frame that carries it.
    """
    return Solid(coal.Box(np.asarray(size, dtype=float)), se3(frame_from_box))


def hull(points: npt.ArrayLike) -> Solid:
    """Return the convex hull of points (N, 3), m.

    Raises:
        GeometryError: There are fewer than four points, or all of them lie in a plane.
    """
    points = np.asarray(points, dtype=float)
    # coal does not look whether Qhull has failed and reads on from nowhere: flat points must not reach it.
    if len(points) < 4 or not np.isfinite(points).all() or _is_flat(points):
        text = f"{len(points)} points have no convex hull that encloses anything; give a closed surface."
        raise GeometryError(text, points=len(points))
    corners = coal.StdVec_Vec3s()
    corners.extend(points)
    with_triangles = coal.ConvexBase.convexHull(corners, True, "Qt")
    return Solid(with_triangles, pinocchio.SE3.Identity())


def _is_flat(points: Floats) -> bool:
    """Return whether points lie in a plane, to seven digits; Qhull computes with sixteen."""
    widest, _, thinnest = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return not thinnest > FLAT * widest


def pose_between(start: Floats, end: Floats) -> Any:
    """Return a frame in the middle of a line segment, with its z axis along the segment.

    Args:
        start: First end of the segment, m, (3,).
        end: Second end of the segment, m, (3,).

    Returns:
        A `pinocchio.SE3` in the frame of both points.
    """
    direction = end - start
    turn = pinocchio.Quaternion.FromTwoVectors(_Z, direction) if any(direction.tolist()) else _NO_TURN
    return pinocchio.SE3(turn, (start + end) / 2.0)


def se3(transform: Transform) -> Any:
    """Return a transform as a `pinocchio.SE3`."""
    return pinocchio.SE3(transform.rotation, transform.translation)
