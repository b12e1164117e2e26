"""Poses of a coil on the scalp: tangent to it, moved along it, and over the hand area of the motor cortex.

`ScalpPatch` holds the places of a search and interpolates poses between them. It replaces the scalp's mesh, which is
not part of the journalled data.
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

__all__ = ["ScalpPatch", "along_scalp", "hand_area", "heading", "on_scalp", "scalp_patch", "turned"]

NEIGHBOURS = 12
"""Number of places to which the scalp around a point is fitted. A quadric has 6 coefficients."""


class ScalpPatch:
    """Places and headings of a search, and the scalp between them.

    Args:
        settings: Settings of the search, which define the headings.
        places: ``image_from_coil`` of the places, tangent to the scalp, (P,). The first is the centre.

    Attributes:
        settings: Settings of the search.
        places: ``image_from_coil`` of the places, (P,).
        positions: Positions of the places in the image, m, (P, 3).
        headings: Angles against a place's own pose, rad, ascending, (H,).
        poses: Every place with every heading, (P H,).
    """

    def __init__(self, settings: HotspotSettings, places: Sequence[PoseMessage]) -> None:
        self.settings = settings
        self.places = tuple(as_transform(place) for place in places)
        self.positions: Floats = np.array([place.translation for place in self.places])
        turns = settings.turns
        self.headings: Floats = np.radians(settings.heading_step_deg * np.arange(-turns, turns + 1))
        self.poses = tuple(turned(place, float(angle)) for place in self.places for angle in self.headings)

    def locate(self, pose: Transform) -> tuple[Floats, float]:
        """Return the position of a pose, m, (3,), and its heading against the nearest place, rad."""
        nearest = int(np.argmin(np.linalg.norm(self.positions - pose.translation, axis=1)))
        return pose.translation, heading(self.places[nearest], pose)

    def pose_at(self, position: Floats, angle: float) -> Transform:
        """Return the pose on the scalp at a position between the places.

        The scalp is the quadric through the nearest places. On a head it is accurate to 0.1 mm for places 7 mm apart.

        Args:
            position: Position in the image, m, (3,).
            angle: Heading against the nearest place, rad.
        """
        distances = np.linalg.norm(self.positions - position, axis=1)
        # A stable order, so that a replay finds the same places at equal distances.
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
def scalp_patch(settings: HotspotSettings, places: tuple[PoseMessage, ...]) -> ScalpPatch:
    """Return the patch of a search. It is cached, because it is the same for all pulses of the search.

    Args:
        settings: Settings of the search.
        places: ``image_from_coil`` of the places, tangent to the scalp; the first is the centre.
    """
    return ScalpPatch(settings, places)


def as_transform(pose: PoseMessage) -> Transform:
    """Return a pose message as a `Transform`. Raises `GeometryError` if the pose is invalid."""
    return Transform.from_quat_wxyz(pose.position, pose.quat_wxyz)


def as_message(pose: Transform) -> PoseMessage:
    """Return a pose as a message."""
    x, y, z = pose.translation.tolist()
    w, i, j, k = pose.quat_wxyz.tolist()
    return PoseMessage(position=(x, y, z), quat_wxyz=(w, i, j, k))


def _quadric(x: Floats, y: Floats) -> Floats:
    """Return the terms of a quadric at points of the tangent plane, (K, 6)."""
    terms: Floats = np.column_stack((np.ones_like(x), x, y, x * x, x * y, y * y))
    return terms


NearestPoints = Callable[[Floats], tuple[Floats, Floats]]
"""Query that returns, for points (K, 3), m, the nearest points of the scalp, m, (K, 3), and its outward unit normals
there, (K, 3), for example `pcmrs.registration.triangles.TriangleSurface.closest`."""

STRIDE = 0.002
"""Longest step along the scalp, m. A head is practically flat over this length."""

HAND_AREA = (0.055, 0.005)
"""Distances of the hand area to the side of the vertex and in front of it, along the scalp, m. They follow from Holmes
et al., J. Neurophysiol. 121 (2019) 336: the finger's sensory area is at 7 to 8 cm, 2 cm beside and 0.5 cm behind it."""

HANDLE = math.radians(45.0)
"""Angle between the coil's handle, which points back and to the side, and the midsagittal plane, rad (Mills et al.,
Electroencephalogr. Clin. Neurophysiol. 85 (1992) 17)."""


def on_scalp(closest: NearestPoints, pose: Transform) -> Transform:
    """Return a pose moved to the nearest point of the scalp and tilted by the least angle that makes it tangent there.

    Args:
        closest: Query for the nearest points of the scalp.
        pose: Pose near the scalp.

    Raises:
        GeometryError: The pose's +z axis points into the head.
    """
    (placed,) = along_scalp(closest, pose, np.zeros((1, 2)))
    return placed


def along_scalp(closest: NearestPoints, start: Transform, offsets: npt.ArrayLike) -> tuple[Transform, ...]:
    """Return poses reached from a start by straight steps along the scalp, without a turn about the normal.

    Args:
        closest: Query for the nearest points of the scalp.
        start: Pose near the scalp whose +z axis points away from the head.
        offsets: Distances along x and y of the coil, m, (K, 2).

    Raises:
        GeometryError: The start's +z axis points into the head, or an offset is not finite.
    """
    steps = np.asarray(offsets, dtype=float)
    if steps.ndim != 2 or steps.shape[1] != 2 or not np.isfinite(steps).all():
        raise GeometryError("Offsets along the scalp are pairs of finite numbers, (K, 2), m.", shape=steps.shape)
    # All poses take the same number of steps, so that they are computed together.
    count = math.ceil(np.linalg.norm(steps, axis=1).max(initial=0.0) / STRIDE)
    points, frames = np.tile(start.translation, (len(steps), 1)), np.tile(start.rotation, (len(steps), 1, 1))
    points, frames = _projected(closest, points, frames)
    for _ in range(count):
        strides = np.einsum("kij,kj->ki", frames[:, :, :2], steps / count)
        points, frames = _projected(closest, points + strides, frames)
    return tuple(Transform(frame, point) for frame, point in zip(frames, points, strict=True))


def hand_area(closest: NearestPoints, vertex: npt.ArrayLike, side: Literal["right", "left"] = "right") -> Transform:
    """Return ``image_from_coil`` over the hand area of one hemisphere, where a search for the hot-spot begins.

    +y of the coil points away from its handle: forwards and to the middle.

    Args:
        closest: Query for the nearest points of the scalp in a RAS image.
        vertex: Top of the head in the image, m, (3,).
        side: Hemisphere of the brain. The hand is on the other side.
    """
    sign = 1.0 if side == "right" else -1.0
    lateral, forward = HAND_AREA
    upright = Transform(np.eye(3), np.asarray(vertex, dtype=float))
    (pose,) = along_scalp(closest, upright, [[sign * lateral, forward]])
    return turned(pose, sign * HANDLE)


def turned(pose: Transform, angle: float) -> Transform:
    """Return a pose turned about its own +z axis.

    Args:
        pose: Pose to turn.
        angle: Angle, rad.
    """
    return pose @ Transform.from_rotvec((0.0, 0.0, 0.0), (0.0, 0.0, angle))


def heading(reference: Transform, pose: Transform) -> float:
    """Return the angle by which a pose is turned about +z against a reference, whatever its tilt, rad, in (-pi, pi].

    Args:
        reference: Pose with heading 0.
        pose: Pose in the frame of the reference's parent.
    """
    # The twist about z of a swing-twist decomposition.
    relative = reference.rotation.T @ pose.rotation
    return math.atan2(relative[1, 0] - relative[0, 1], relative[0, 0] + relative[1, 1])


def _projected(closest: NearestPoints, points: Floats, frames: Floats) -> tuple[Floats, Floats]:
    """Return points moved onto the scalp, and their axes turned by the least rotation that takes +z to the normal.

    That rotation is ``I + [v] + [v]^2 / (1 + c)`` with the cross product v and the dot product c of both.
    """
    nearest, normals = closest(points)
    axes = frames[:, :, 2]
    cosines = np.sum(axes * normals, axis=1)
    if not cosines.min(initial=1.0) > 0.0:
        raise GeometryError("+z of the coil points into the head; flip the pose.", cosine=float(cosines.min()))
    x, y, z = np.cross(axes, normals).T
    zero = np.zeros_like(x)
    skew = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    rotations = np.eye(3) + skew + skew @ skew / (1.0 + cosines)[:, None, None]
    return nearest, rotations @ frames
