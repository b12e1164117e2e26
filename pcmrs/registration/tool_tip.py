"""Contact point and axes of a tool in its marker body, with their predicted error.

Three ways: known points of the tool that a pointer has touched, points touched on the tool's mesh in addition, and, for
a tool that is symmetric about its axis, pivoting about both ends of the axis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pcmrs.errors import RefusalError
from pcmrs.registration._points import register_points
from pcmrs.registration.pivot import PivotCalibration, calibrate_pivot
from pcmrs.registration.rigid import motion_jacobians
from pcmrs.registration.surface import refine_with_surface
from pcmrs.spatial import Floats, Transform

__all__ = ["ToolTip", "TouchNoise", "tip_from_mesh", "tip_from_pivots", "tip_from_points"]

MIN_AXIS = 0.02
"""Least distance between the two ends of an axis, m: at 0.1 mm at each end it gives the axis within 0.4°."""
NEARLY_PARALLEL = 0.9
"""Cosine beyond which an axis of the marker body does not determine the direction across the tool."""


@dataclass(frozen=True, slots=True)
class TouchNoise:
    """Known noise of touches, standard deviation per axis.

    Attributes:
        point: Of a known point that is touched, m.
        surface: Of a point touched on the mesh along its normal, including the mesh's error, m.
    """

    point: float
    surface: float


@dataclass(frozen=True, eq=False)
class ToolTip:
    """Contact point of a tool, and how well it is known.

    Attributes:
        tool_marker_from_tool_tip: Contact point and axes in the marker body.
        error: Predicted rms error of the contact point, m.
        angle_error: Predicted rms error of the axes, rad; for a symmetric tool of its z axis.
        distances: Distance of each touch or pose from the result, m, (N,).
        rms: Root mean square of the distances that were used, m.
        bad: Indices of the poses that were left out.
    """

    tool_marker_from_tool_tip: Transform
    error: float
    angle_error: float
    distances: Floats
    rms: float
    bad: tuple[int, ...] = ()


def tip_from_points(
    points_in_tool_tip: npt.ArrayLike, points_in_tool_marker: npt.ArrayLike, noise: TouchNoise
) -> ToolTip:
    """Return the contact point by three or more known points of the tool.

    The noise of the touches is estimated from the residuals, but not below the known one: few points fit too well.

    Args:
        points_in_tool_tip: Known points, in the frame of the contact point, m, (N, 3).
        points_in_tool_marker: The same points as they were touched, in the marker body, m, (N, 3).
        noise: Known noise of the touches.

    Raises:
        GeometryError: The points are not pairs of finite points.
        DegeneratePointsError: There are fewer than three points, or they are on one line.
        MirroredPointsError: A mirror image fits far better.
    """
    fit = register_points(points_in_tool_marker, points_in_tool_tip)
    touched = np.asarray(points_in_tool_marker, dtype=float)
    sigma = _sigma(fit.distances, noise.point)
    tip = fit.fixed_from_moving
    centre = touched.mean(axis=0)
    jacobians = motion_jacobians(touched - centre)
    covariance = sigma**2 * np.linalg.inv(np.einsum("nij,nik->jk", jacobians, jacobians))
    error, angle_error = _errors(covariance, tip.translation - centre)
    return ToolTip(tip, error, angle_error, fit.distances, fit.rms)


def tip_from_mesh(
    points_in_tool_tip: npt.ArrayLike,
    points_in_tool_marker: npt.ArrayLike,
    vertices: npt.ArrayLike,
    faces: npt.ArrayLike,
    surface_in_tool_marker: npt.ArrayLike,
    noise: TouchNoise,
) -> ToolTip:
    """Return the contact point by known points, refined by points touched anywhere on the tool's mesh.

    Args:
        points_in_tool_tip: Known points, in the frame of the contact point, m, (N, 3).
        points_in_tool_marker: The same points as they were touched, in the marker body, m, (N, 3).
        vertices: Vertices of the mesh in the frame of the contact point, m, (V, 3).
        faces: Triangles of the mesh, counter-clockwise seen from outside, (F, 3).
        surface_in_tool_marker: Points touched on the surface, in the marker body, m, (K, 3).
        noise: Known noise of the touches.

    Returns:
        The contact point. Its distances are those of the known points.

    Raises:
        GeometryError: See `tip_from_points` and `pcmrs.registration.surface.refine_with_surface`.
        RefusalError: The mesh does not fit the touched points, or does not improve the result.
    """
    coarse = tip_from_points(points_in_tool_tip, points_in_tool_marker, noise)
    known, touched = np.asarray(points_in_tool_tip, dtype=float), np.asarray(points_in_tool_marker, dtype=float)
    sigma = _sigma(coarse.distances, noise.point)
    refined = refine_with_surface(
        coarse.tool_marker_from_tool_tip,
        known,
        touched,
        sigma,
        vertices,
        faces,
        surface_in_tool_marker,
        noise.surface,
        np.zeros(3),
    )
    tip = refined.body_ref_from_image
    distances = np.linalg.norm(tip @ known - touched, axis=1)
    # The covariance is about the origin of the marker body, like the motion itself.
    error, angle_error = _errors(refined.covariance, tip.translation)
    return ToolTip(tip, error, angle_error, distances, float(np.sqrt(np.mean(distances**2))))


def tip_from_pivots(at_tip: Sequence[Transform], at_end: Sequence[Transform]) -> ToolTip:
    """Return the contact point of a tool that is symmetric about its axis, such as a drill guide.

    The +z axis points from the tip to the other end, away from the body. The other two axes are chosen: +x is as near
    as possible to that of the marker body.

    Args:
        at_tip: Poses of the marker body in the tracker frame while the tip rests on one point, (N,).
        at_end: Poses while a point on the axis, above the tip, rests on one point, (M,).

    Raises:
        DegenerateMotionError: There are too few poses, or the tool was turned about one axis only.
        RefusalError: ``too_many_bad_poses``, or ``axis_too_short``.
    """
    tip, end = calibrate_pivot(at_tip), calibrate_pivot(at_end)
    axis = end.tip_in_pointer - tip.tip_in_pointer
    length = float(np.linalg.norm(axis))
    if length < MIN_AXIS:
        text = (
            f"Both ends of the axis are {length * 1000:.1f} mm apart, at least {MIN_AXIS * 1000:g} mm are needed: "
            "pivot about the tip, then about a point far above it."
        )
        raise RefusalError("axis_too_short", text, length=length, limit=MIN_AXIS)
    z = axis / length
    across = np.eye(3)[0] if abs(z[0]) < NEARLY_PARALLEL else np.eye(3)[1]
    y = np.cross(z, across)
    y /= np.linalg.norm(y)
    pose = Transform(np.column_stack((np.cross(y, z), y, z)), tip.tip_in_pointer)
    # Residuals include what all poses of a scatter do not: the covariance of a bent tool would be too small.
    across_axis = math.hypot(_pivot_error(tip), _pivot_error(end))
    distances = np.concatenate((tip.distances, end.distances))
    bad = (*tip.bad, *(len(tip.distances) + index for index in end.bad))
    used = np.delete(distances, bad)
    return ToolTip(
        pose, _pivot_error(tip), across_axis / length, distances, float(np.sqrt(np.mean(used**2))), tuple(bad)
    )


def _pivot_error(found: PivotCalibration) -> float:
    return max(found.rms, float(np.sqrt(np.trace(found.covariance))))


def _sigma(distances: Floats, known: float) -> float:
    """Return the noise per axis, m, from the residuals of a rigid fit, but not below the known one."""
    freedom = 3 * len(distances) - 6  # the fit has 6 parameters
    return max(known, math.sqrt(float(distances @ distances) / freedom))


def _errors(covariance: Floats, tip: Floats) -> tuple[float, float]:
    """Return the rms errors of the contact point, m, and of the axes, rad.

    Args:
        covariance: Covariance of a small motion ``(rotation vector, translation)``, rad and m, (6, 6).
        tip: Contact point in the frame of the motion, m, (3,).
    """
    (jacobian,) = motion_jacobians(tip[None])
    at_tip = jacobian @ covariance @ jacobian.T
    return float(np.sqrt(np.trace(at_tip))), float(np.sqrt(np.trace(covariance[:3, :3])))
