"""Poses of a coil on the scalp: tangent to it, moved along it, and over the hand area of the motor cortex."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError
from pcmrs.spatial import Floats, Transform

Closest = Callable[[Floats], tuple[Floats, Floats]]
"""Tells of points (K, 3), m, the nearest points of the scalp, m, (K, 3), and its outward unit normals there, (K, 3).

`pcmrs.registration.triangles.TriangleSurface.closest` is one.
"""

STRIDE = 0.002
"""Longest step of a walk along the scalp, m: a head is flat over it."""

HAND_AREA = (0.055, 0.005)
"""How far the hand area is to the side of the vertex and before it, along the scalp, m: Holmes et al., J. Neurophysiol.
121 (2019) 336, from the finger's sensory area at 7 to 8 cm, which is 2 cm beside and 0.5 cm behind it."""

HANDLE = math.radians(45.0)
"""Between the coil's handle, which points back and to the side, and the midsagittal plane: Mills et al.,
Electroencephalogr. Clin. Neurophysiol. 85 (1992) 17."""


def on_scalp(closest: Closest, pose: Transform) -> Transform:
    """The pose moved to the nearest point of the scalp and tilted as little as may be, so that it is tangent there.

    Raises:
        GeometryError: Its +z points into the head.
    """
    (placed,) = along_scalp(closest, pose, np.zeros((1, 2)))
    return placed


def along_scalp(closest: Closest, start: Transform, offsets: npt.ArrayLike) -> tuple[Transform, ...]:
    """Poses reached from `start` by walking straight along the scalp, the handle never turned about the normal.

    Args:
        closest: The scalp.
        start: Any pose near the scalp whose +z points away from the head.
        offsets: How far to go along x and y of the coil, m, (K, 2).

    Raises:
        GeometryError: +z of the start points into the head, or an offset is not finite.
    """
    steps = np.asarray(offsets, dtype=float)
    if steps.ndim != 2 or steps.shape[1] != 2 or not np.isfinite(steps).all():
        raise GeometryError("Offsets along the scalp are pairs of finite numbers, (K, 2), m.", shape=steps.shape)
    count = math.ceil(np.linalg.norm(steps, axis=1).max(initial=0.0) / STRIDE)
    points, frames = np.tile(start.translation, (len(steps), 1)), np.tile(start.rotation, (len(steps), 1, 1))
    points, frames = _settled(closest, points, frames)
    for _ in range(count):
        strides = np.einsum("kij,kj->ki", frames[:, :, :2], steps / count)
        points, frames = _settled(closest, points + strides, frames)
    return tuple(Transform(frame, point) for frame, point in zip(frames, points, strict=True))


def hand_area(closest: Closest, vertex: npt.ArrayLike, side: Literal["right", "left"] = "right") -> Transform:
    """``image_from_coil`` over the hand area of one hemisphere: where a search for the hot-spot begins.

    +y of the coil points away from its handle: forwards and to the middle.

    Args:
        closest: The scalp in a RAS image.
        vertex: Top of the head, m, (3,).
        side: Of the brain; the hand is on the other.
    """
    sign = 1.0 if side == "right" else -1.0
    aside, ahead = HAND_AREA
    upright = Transform(np.eye(3), np.asarray(vertex, dtype=float))
    (pose,) = along_scalp(closest, upright, [[sign * aside, ahead]])
    return turned(pose, sign * HANDLE)


def turned(pose: Transform, angle: float) -> Transform:
    """The pose turned about its own +z by `angle`, rad."""
    return pose @ Transform.from_rotvec((0.0, 0.0, 0.0), (0.0, 0.0, angle))


def heading(reference: Transform, pose: Transform) -> float:
    """Angle by which `pose` is turned about +z against `reference`, whatever its tilt, rad, in (-pi, pi]."""
    relative = reference.rotation.T @ pose.rotation
    return math.atan2(relative[1, 0] - relative[0, 1], relative[0, 0] + relative[1, 1])


def _settled(closest: Closest, points: Floats, frames: Floats) -> tuple[Floats, Floats]:
    """Points moved onto the scalp, and their axes turned by the least rotation that takes +z to the normal.

    That rotation is ``I + [v] + [v]^2 / (1 + c)`` with the cross product v and the dot product c of both.
    """
    nearest, normals = closest(points)
    axes = frames[:, :, 2]
    cosines = np.sum(axes * normals, axis=1)
    if not cosines.min(initial=1.0) > 0.0:
        raise GeometryError("+z of the coil points into the head; turn the pose over.", cosine=float(cosines.min()))
    x, y, z = np.cross(axes, normals).T
    zero = np.zeros_like(x)
    skew = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    rotations = np.eye(3) + skew + skew @ skew / (1.0 + cosines)[:, None, None]
    return nearest, rotations @ frames
