"""Geometries of arms whose inverse kinematics has a closed form, recognized in the zero posture of a model.

All dimensions come from the model that is loaded. A model whose axes are off by more than `SAME`, such as a UR with the
measured dimensions of one arm, has none of these geometries: a closed form would miss its poses.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import atan2

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats, Transform, trusted_transform

SAME = 1e-9
"""Greatest deviation of positions, m, and of the components of unit vectors: URDF files round half turns to 1e-9."""

_SRS_AXES = np.array(((0, 0, 1), (0, 1, 0), (0, 0, 1), (0, -1, 0), (0, 0, 1), (0, 1, 0), (0, 0, 1)))
_UR_AXES = np.array(((0, 0, 1), (0, 1, 0), (0, 1, 0), (0, 1, 0), (0, 0, -1), (0, 1, 0)))
_PANDA_AXES = np.array(((0, 0, 1), (0, 1, 0), (0, 0, 1), (0, -1, 0), (0, 0, 1), (0, -1, 0), (0, 0, -1)))


@dataclass(frozen=True, eq=False)
class SrsGeometry:
    """Spherical shoulder, elbow and spherical wrist: an arm that stands upright in the zero posture.

    Its joint axes are then along z, y, z, -y, z, y, z of the base, and all origins are above that of the base.

    Attributes:
        heights: Heights of the joints and of the flange above the base in the zero posture, m, (8,).
    """

    heights: Floats

    @property
    def shoulder(self) -> Floats:
        """Position of the shoulder in the base, m, (3,)."""
        return np.array((0.0, 0.0, self.heights[1]))

    def singular_angles(self, q: Floats) -> Floats:
        """Return the distances of shoulder, elbow and wrist from a straight one, rad, (3, ...).

        Args:
            q: Joint positions, rad, (7, ...).
        """
        return np.abs(q[1::2])


@dataclass(frozen=True, eq=False)
class _Mounted:
    """An arm on any stand, with any flange.

    Attributes:
        base_from_shoulder: Pose of the shoulder frame in the robot's base.
        last_from_flange: Pose of the flange in the frame of the last link, which in the zero posture has the axes of
            the shoulder frame and its origin where axes 5 and 6 meet.
    """

    base_from_shoulder: Transform
    last_from_flange: Transform

    @cached_property
    def _outer(self) -> tuple[Transform, Transform]:
        return self.base_from_shoulder.inverse(), self.last_from_flange.inverse()

    def shoulder_from_last(self, base_from_flange: Transform) -> Transform:
        """Return the pose of the last link in the shoulder frame for a pose of the flange."""
        shoulder_from_base, flange_from_last = self._outer
        return shoulder_from_base @ base_from_flange @ flange_from_last


@dataclass(frozen=True, eq=False)
class UrGeometry(_Mounted):
    """Shoulder, three parallel axes and a wrist whose last two axes meet, as in the arms of Universal Robots.

    The shoulder frame has its origin where axes 1 and 2 meet, z along axis 1 and y along axis 2. In the zero posture
    the axes are along z, y, y, y, -z, y of it. Vectors in its plane of x and z are complex numbers x - iz, so that a
    turn by q about y multiplies them by exp(iq). In brackets: the name of the length in the manufacturer's table of
    Denavit-Hartenberg parameters, whose d1 is the height of the shoulder and whose d6 lies in `last_from_flange`.

    Attributes:
        upper_arm: Vector from axis 2 to axis 3 in the zero posture, m [a2].
        forearm: Vector from axis 3 to axis 4 in the zero posture, m [a3].
        hand: Vector from axis 4 to the point where axes 5 and 6 meet in the zero posture, m [d5].
        offset: Distance of that point from the plane of x and z, along y, m [d4].
    """

    upper_arm: complex
    forearm: complex
    hand: complex
    offset: float

    def singular_angles(self, q: Floats) -> Floats:
        """Return how far shoulder, elbow and wrist are from where their two solutions meet, rad, (3, ...).

        Args:
            q: Joint positions, rad, (6, ...).
        """
        turns = np.exp(1j * np.cumsum(q[1:4], axis=0))
        across = self.upper_arm * turns[0] + self.forearm * turns[1] + self.hand * turns[2]
        elbow = q[2] + np.angle(self.forearm / self.upper_arm)
        return np.array(
            (np.arctan2(np.abs(across.real), abs(self.offset)), _from_straight(elbow), _from_straight(q[4]))
        )


@dataclass(frozen=True, eq=False)
class PandaGeometry(_Mounted):
    """Spherical shoulder, elbow beside the line from shoulder to wrist, and a last axis beside the wrist: a Panda.

    The shoulder frame has its origin where axes 1, 2 and 3 meet, z along axis 1 and y along axis 2. In the zero posture
    the axes are along z, y, z, -y, z, -y, -z of it, and axes 5 and 6 meet above the shoulder, at the wrist. In
    brackets: the name of the length in the manufacturer's table of Denavit-Hartenberg parameters.

    Attributes:
        upper_arm: Height of axis 4 above the shoulder in the zero posture, m [d3].
        forearm: Height of the wrist above axis 4 in the zero posture, m [d5].
        elbow: Distance of axis 4 from the line from shoulder to wrist in the zero posture, along x, m [a4].
        hand: Distance of axis 7 from the wrist, along x, m [a7].
    """

    upper_arm: float
    forearm: float
    elbow: float
    hand: float

    @property
    def stretched(self) -> float:
        """Position of joint 4 at which the wrist is farthest from the shoulder, rad."""
        sine, cosine = -self.elbow * (self.upper_arm + self.forearm), self.upper_arm * self.forearm - self.elbow**2
        return atan2(sine, cosine)

    def singular_angles(self, q: Floats) -> Floats:
        """Return the distances of shoulder, elbow and wrist from a straight one, rad, (3, ...).

        Args:
            q: Joint positions, rad, (7, ...).
        """
        return np.array((np.abs(q[1]), _from_straight(q[3] - self.stretched), _from_straight(q[5])))


Geometry = SrsGeometry | UrGeometry | PandaGeometry


def recognize(axes: Floats, origins: Floats, base_from_flange: Transform) -> Geometry | None:
    """Return the geometry of an arm in its zero posture, or None if no closed form fits it.

    Args:
        axes: Unit vectors of the joint axes in the base, (n, 3).
        origins: A point on each axis in the base, m, (n, 3).
        base_from_flange: Pose of the flange.
    """
    return (
        _srs(axes, origins, base_from_flange)
        or _ur(axes, origins, base_from_flange)
        or _panda(axes, origins, base_from_flange)
    )


def _srs(axes: Floats, origins: Floats, base_from_flange: Transform) -> SrsGeometry | None:
    if not _parallel(axes, _SRS_AXES):
        return None
    places = np.vstack((origins, base_from_flange.translation))
    upright = _same(places[:, :2], 0.0) and _same(base_from_flange.rotation, np.eye(3))
    return SrsGeometry(places[:, 2]) if upright else None


def _ur(axes: Floats, origins: Floats, base_from_flange: Transform) -> UrGeometry | None:
    shoulder = _shoulder_frame(axes, origins)
    if shoulder is None or not _parallel(axes @ shoulder.rotation, _UR_AXES):
        return None
    places = np.array([shoulder.inverse() @ origin for origin in origins])
    wrist = np.array((places[4, 0], places[4, 1], places[5, 2]))
    if not _same(places[5, 0], wrist[0]):
        return None
    elbow, hand, end = (complex(place[0], -place[2]) for place in (places[2], places[3], wrist))
    if min(abs(elbow), abs(hand - elbow), abs(end - hand), abs(wrist[1])) < SAME:
        return None
    last = shoulder @ trusted_transform(np.eye(3), wrist)
    return UrGeometry(shoulder, last.inverse() @ base_from_flange, elbow, hand - elbow, end - hand, float(wrist[1]))


def _panda(axes: Floats, origins: Floats, base_from_flange: Transform) -> PandaGeometry | None:
    shoulder = _shoulder_frame(axes, origins)
    if shoulder is None or not _parallel(axes @ shoulder.rotation, _PANDA_AXES):
        return None
    places = np.array([shoulder.inverse() @ origin for origin in origins])
    wrist = np.array((0.0, 0.0, places[5, 2]))
    # Axes 3 and 5 are that of the shoulder, axis 6 meets them, and axis 7 is in the plane of x and z.
    if not _same((*places[2, :2], *places[4, :2], places[5, 0], places[6, 1]), 0.0):
        return None
    (elbow, _, upper_arm), hand = places[3].tolist(), float(places[6, 0])
    forearm = float(wrist[2]) - upper_arm
    if min(elbow, hand, upper_arm, forearm) < SAME:
        return None
    last = shoulder @ trusted_transform(np.eye(3), wrist)
    return PandaGeometry(shoulder, last.inverse() @ base_from_flange, upper_arm, forearm, elbow, hand)


def _from_straight(angles: Floats) -> Floats:
    """Return the distances of angles from the nearest half turn, rad, of the same shape."""
    distances: Floats = np.abs(np.arcsin(np.sin(angles)))
    return distances


def _shoulder_frame(axes: Floats, origins: Floats) -> Transform | None:
    """Return the pose of the shoulder frame in the base; None if axes 1 and 2 do not meet at a right angle."""
    if len(axes) < 2 or not _same(axes[0] @ axes[1], 0.0):
        return None
    z, y = axes[0], axes[1]
    x = np.cross(y, z)
    apart = origins[1] - origins[0]
    if not _same(apart @ x, 0.0):
        return None
    x /= np.linalg.norm(x)
    return trusted_transform(np.column_stack((x, np.cross(z, x), z)), origins[0] + (apart @ z) * z)


def _same(values: npt.ArrayLike, expected: npt.ArrayLike) -> bool:
    return bool(np.allclose(values, expected, rtol=0.0, atol=SAME))


def _parallel(axes: Floats, expected: Floats) -> bool:
    return axes.shape == expected.shape and _same(axes, expected)
