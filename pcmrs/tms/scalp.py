"""Poses of a coil on the scalp: tangent to it, moved along it, and over the hand area of the motor cortex.

The places of a search on the scalp, and poses between them: what is left of the scalp in the journalled data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Literal

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError
from pcmrs.messages import PoseMessage
from pcmrs.spatial import Floats, Transform
from pcmrs.tms.settings import HotspotSettings

NEIGHBOURS = 12
"""Places that the scalp around a point is fitted to: a quadric has 6 coefficients."""


class ScalpPatch:
    """Places and headings that may be asked for, and the scalp between them.

    Args:
        settings: Of the search; which headings.
        places: ``image_from_coil`` of the places, tangent to the scalp; the first is the centre.
    """

    def __init__(self, settings: HotspotSettings, places: Sequence[PoseMessage]) -> None:
        self.settings = settings
        self.places = tuple(as_transform(place) for place in places)
        self.positions: Floats = np.array([place.translation for place in self.places])
        turns = settings.turns
        self.headings: Floats = np.radians(settings.heading_step_deg * np.arange(-turns, turns + 1))
        """Against the place's own pose, rad, in order."""

        self.poses = tuple(turned(place, float(angle)) for place in self.places for angle in self.headings)
        """Every place with every heading."""

    def located(self, pose: Transform) -> tuple[Floats, float]:
        """Position of a pose, m, (3,), and its heading against the place that is nearest, rad."""
        nearest = int(np.argmin(np.linalg.norm(self.positions - pose.translation, axis=1)))
        return pose.translation, heading(self.places[nearest], pose)

    def pose(self, position: Floats, angle: float) -> Transform:
        """The pose on the scalp at a position between the places, turned by `angle` (rad) from theirs.

        The scalp is the quadric through the nearest places: within 0.1 mm of a head for places 7 mm apart.
        """
        distances = np.linalg.norm(self.positions - position, axis=1)
        nearest = np.argsort(distances, kind="stable")[:NEIGHBOURS]
        place = self.places[nearest[0]]
        local = place.inverse() @ self.positions[nearest]
        x, y, _ = place.inverse() @ position
        coefficients, *_ = np.linalg.lstsq(_quadric(local[:, 0], local[:, 1]), local[:, 2])
        height = float(_quadric(np.array([x]), np.array([y]))[0] @ coefficients)
        _, ax, ay, axx, axy, ayy = coefficients
        normal = np.array((-(ax + 2.0 * axx * x + axy * y), -(ay + 2.0 * ayy * y + axy * x), 1.0))
        normal /= np.linalg.norm(normal)
        tilt = np.cross((0.0, 0.0, 1.0), normal)
        sine = float(np.linalg.norm(tilt))
        rotvec = tilt * (np.arcsin(min(sine, 1.0)) / sine) if sine > 0.0 else tilt
        return turned(place @ Transform.from_rotvec((x, y, height), rotvec), angle)


@lru_cache(maxsize=8)
def chart_of(settings: HotspotSettings, places: tuple[PoseMessage, ...]) -> ScalpPatch:
    """The chart of a search; it stays the same for all its pulses."""
    return ScalpPatch(settings, places)


def as_transform(pose: PoseMessage) -> Transform:
    """The pose to compute with. Raises `GeometryError` where it is none."""
    return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)


def as_message(pose: Transform) -> PoseMessage:
    """The pose as data."""
    x, y, z = pose.translation.tolist()
    w, i, j, k = pose.quat_wxyz.tolist()
    return PoseMessage(position=(x, y, z), quat_wxyz=(w, i, j, k))


def _quadric(x: Floats, y: Floats) -> Floats:
    """Terms of a quadric at points of the tangent plane, (K, 6)."""
    terms: Floats = np.column_stack((np.ones_like(x), x, y, x * x, x * y, y * y))
    return terms


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
