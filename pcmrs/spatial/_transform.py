"""Rigid transforms: a rotation and a translation that map points of one frame into another."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self, overload

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError

Floats = npt.NDArray[np.float64]
"""Array of numbers; its shape and unit are in the text beside it."""

ORTHONORMAL_TOLERANCE = 1e-6
GIMBAL_LOCK = 1e-7
"""Cosine of the middle angle below which the first and the last rotation are about the same axis."""
UNIT_QUATERNION_TOLERANCE = 1e-3  # quaternions that arrive as text have few decimals; they are normalized


@dataclass(frozen=True, eq=False, slots=True)
class Transform:
    """A rigid transform, named ``a_from_b``: ``p_a = a_from_b @ p_b``.

    Its arrays are copies and cannot be written to.

    Attributes:
        rotation: Right-handed orthonormal matrix, (3, 3).
        translation: Origin of frame b in frame a, m, (3,).

    Raises:
        GeometryError: A number is not finite, a shape is wrong, or the matrix is not a rotation.
    """

    rotation: Floats
    translation: Floats

    def __post_init__(self) -> None:
        rotation = _array(self.rotation, (3, 3), "rotation matrix")
        _check_rotation(rotation)
        _fill(self, rotation, _array(self.translation, (3,), "translation"))

    def __reduce__(self) -> tuple[Callable[[bytes], Transform], tuple[bytes]]:
        # A request to the planning process contains hundreds of poses, and an array takes ten times as long.
        return _from_bytes, (self.rotation.tobytes() + self.translation.tobytes(),)

    @classmethod
    def identity(cls) -> Self:
        """Return the transform between frames that coincide."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_quat_wxyz(cls, position: npt.ArrayLike, quat: npt.ArrayLike) -> Self:
        """Return a transform from a translation and a unit quaternion w x y z.

        Args:
            position: Translation, m, (3,).
            quat: Unit quaternion in the order w x y z, (4,).

        Raises:
            GeometryError: The length of the quaternion is not 1 within `UNIT_QUATERNION_TOLERANCE`.
        """
        w, x, y, z = _unit_quaternion(quat)
        return cls._from_unit_quaternion(position, x, y, z, w)

    @classmethod
    def from_quat_xyzw(cls, position: npt.ArrayLike, quat: npt.ArrayLike) -> Self:
        """Return a transform from a translation and a unit quaternion x y z w.

        Args:
            position: Translation, m, (3,).
            quat: Unit quaternion in the order x y z w, (4,).

        Raises:
            GeometryError: The length of the quaternion is not 1 within `UNIT_QUATERNION_TOLERANCE`.
        """
        return cls._from_unit_quaternion(position, *_unit_quaternion(quat))

    @classmethod
    def _from_unit_quaternion(cls, position: npt.ArrayLike, x: float, y: float, z: float, w: float) -> Self:
        """Build the rotation without a check, because it is valid by construction.

        Every tracked pose takes this path.
        """
        rotation = np.array(
            (
                (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
                (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
                (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
            )
        )
        transform = object.__new__(cls)
        _fill(transform, rotation, _array(position, (3,), "translation"))
        return transform

    @classmethod
    def from_matrix(cls, matrix: npt.ArrayLike) -> Self:
        """Return a transform from a homogeneous matrix (4, 4) with its translation in m.

        Raises:
            GeometryError: The last row is not 0 0 0 1, or the upper left part is not a rotation.
        """
        matrix = _array(matrix, (4, 4), "homogeneous matrix")
        if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), rtol=0.0, atol=ORTHONORMAL_TOLERANCE):
            raise GeometryError(
                f"The last row of a rigid transform is 0 0 0 1, not {matrix[3].tolist()}; send a rigid transform.",
                row=matrix[3].tolist(),
            )
        return cls(matrix[:3, :3], matrix[:3, 3])

    @classmethod
    def from_rotvec(cls, position: npt.ArrayLike, rotvec: npt.ArrayLike) -> Self:
        """Return a transform from a translation and a rotation vector.

        Args:
            position: Translation, m, (3,).
            rotvec: Rotation vector: axis times angle, rad, (3,).
        """
        x, y, z = _array(rotvec, (3,), "rotation vector").tolist()
        half = 0.5 * math.hypot(x, y, z)
        scale = 0.5 * (math.sin(half) / half if half else 1.0)
        return cls._from_unit_quaternion(position, scale * x, scale * y, scale * z, math.cos(half))

    @classmethod
    def from_zyx(cls, position: npt.ArrayLike, angles: npt.ArrayLike) -> Self:
        """Return a transform from a translation and the angles a b c of ``Rz(a) Ry(b) Rx(c)``, as in a KUKA pose.

        Args:
            position: Translation, m, (3,).
            angles: Angles a b c, rad, (3,). They are also yaw, pitch and roll of a URDF's ``rpy``, in this order.
        """
        a, b, c = _array(angles, (3,), "angles").tolist()
        sa, ca, sb, cb, sc, cc = math.sin(a), math.cos(a), math.sin(b), math.cos(b), math.sin(c), math.cos(c)
        rotation = np.array(
            (
                (ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc),
                (sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc),
                (-sb, cb * sc, cb * cc),
            )
        )
        return cls(rotation, _array(position, (3,), "translation"))

    @overload
    def __matmul__(self, other: Transform) -> Transform: ...

    @overload
    def __matmul__(self, other: npt.ArrayLike) -> Floats: ...

    def __matmul__(self, other: Transform | npt.ArrayLike) -> Transform | Floats:
        if isinstance(other, Transform):
            return trusted_transform(
                self.rotation @ other.rotation, self.rotation @ other.translation + self.translation
            )
        points = np.asarray(other, dtype=float)
        if points.ndim not in (1, 2) or points.shape[-1] != 3:
            raise GeometryError(f"Points have shape (3,) or (N, 3), not {points.shape}.", shape=points.shape)
        moved: Floats = points @ self.rotation.T + self.translation
        return moved

    def inverse(self) -> Transform:
        """Return ``b_from_a`` of ``a_from_b``."""
        return trusted_transform(self.rotation.T, -self.rotation.T @ self.translation)

    @property
    def matrix(self) -> Floats:
        """Homogeneous matrix, (4, 4)."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.translation
        return matrix

    @property
    def quat_wxyz(self) -> Floats:
        """Unit quaternion w x y z with w >= 0, (4,)."""
        return np.array(_quaternion(self.rotation))

    @property
    def quat_xyzw(self) -> Floats:
        """Unit quaternion x y z w with w >= 0, (4,)."""
        w, x, y, z = _quaternion(self.rotation)
        return np.array((x, y, z, w))

    @property
    def rotvec(self) -> Floats:
        """Rotation vector: axis times angle in [0, pi] rad, (3,)."""
        w, x, y, z = _quaternion(self.rotation)
        sine = math.hypot(x, y, z)
        scale = 2.0 * math.atan2(sine, w) / sine if sine else 2.0
        return np.array((scale * x, scale * y, scale * z))

    @property
    def zyx(self) -> Floats:
        """Angles a b c of ``Rz(a) Ry(b) Rx(c)``, (3,) in rad, with b in [-pi/2, pi/2].

        At b = +-pi/2 only the sum or difference of a and c is determined; c is 0 then.
        """
        (a, b, _), (d, e, _), (g, h, i) = self.rotation.tolist()
        cosine = math.hypot(a, d)
        if cosine > GIMBAL_LOCK:
            return np.array((math.atan2(d, a), math.atan2(-g, cosine), math.atan2(h, i)))
        return np.array((math.atan2(-b, e), math.atan2(-g, cosine), 0.0))


def rotation_angle(one: Transform, other: Transform) -> float:
    """Return the angle between the rotations of two poses of one frame, in [0, pi] rad.

    It follows from ``|R - R^T| = 2 sqrt(2) sin(angle)`` (Frobenius norm) and ``trace R = 1 + 2 cos(angle)``. An arc
    cosine alone would lose half of the digits of small angles. It uses plain floats, because every tracked pose takes
    this path.

    Args:
        one: First pose.
        other: Second pose.
    """
    (a, b, c), (d, e, f), (g, h, i) = (one.rotation.T @ other.rotation).tolist()
    return math.atan2(math.hypot(h - f, c - g, d - b), a + e + i - 1.0)


def distance(a: Transform, b: Transform) -> float:
    """Return the distance between the origins of two poses of one frame, m.

    Args:
        a: First pose.
        b: Second pose.
    """
    return math.dist(a.translation.tolist(), b.translation.tolist())


def mean_transform(transforms: Sequence[Transform]) -> Transform:
    """Return the mean translation and the chordal mean rotation (Hartley et al., Rotation Averaging, IJCV 2013).

    Raises:
        GeometryError: There are no transforms.
    """
    if not transforms:
        raise GeometryError("The mean of no transforms does not exist; give at least one.")
    quaternions = np.array([_quaternion(transform.rotation) for transform in transforms])
    translations = np.array([transform.translation for transform in transforms])
    # The mean is the eigenvector of the largest eigenvalue, which is the last. It does not depend on quaternion signs.
    mean = np.linalg.eigh(quaternions.T @ quaternions).eigenvectors[:, -1]
    return Transform.from_quat_wxyz(translations.mean(axis=0), mean)


def trusted_transform(rotation: Floats, translation: Floats) -> Transform:
    """Return a transform from parts known to be valid, without a check or a copy: composition is on every control path.

    Args:
        rotation: Rotation matrix, (3, 3). The transform takes it over and makes it read-only.
        translation: Translation, m, (3,). The transform takes it over and makes it read-only.
    """
    transform = object.__new__(Transform)
    _fill(transform, rotation, translation)
    return transform


def _from_bytes(content: bytes) -> Transform:
    """Return the transform that was pickled."""
    numbers = np.frombuffer(content)
    return trusted_transform(numbers[:9].reshape(3, 3), numbers[9:])


def _fill(transform: Transform, rotation: Floats, translation: Floats) -> None:
    # The dataclass is frozen, so its fields are set past its guard.
    rotation.flags.writeable = translation.flags.writeable = False
    object.__setattr__(transform, "rotation", rotation)
    object.__setattr__(transform, "translation", translation)


def _unit_quaternion(quat: npt.ArrayLike) -> tuple[float, float, float, float]:
    """Return the normalized quaternion in its own order. Raises `GeometryError` if it is not a unit quaternion."""
    a, b, c, d = _array(quat, (4,), "quaternion").tolist()
    norm = math.sqrt(a * a + b * b + c * c + d * d)
    if abs(norm - 1.0) > UNIT_QUATERNION_TOLERANCE:
        raise GeometryError(
            f"The quaternion has length {norm:.6g}, not 1 within {UNIT_QUATERNION_TOLERANCE:g}; "
            "send a unit quaternion.",
            norm=norm,
            tolerance=UNIT_QUATERNION_TOLERANCE,
        )
    return a / norm, b / norm, c / norm, d / norm


def _quaternion(rotation: Floats) -> tuple[float, float, float, float]:
    """Return the unit quaternion w x y z with w >= 0 of a rotation matrix (3, 3).

    It is computed from its largest component, so that no digits are lost (Shepperd, Quaternion from Rotation Matrix,
    1978). It uses plain floats, because every published pose takes this path.
    """
    (a, b, c), (d, e, f), (g, h, i) = rotation.tolist()
    squares = (1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i)  # four times w^2, x^2, y^2, z^2
    largest = max(squares)
    if largest == squares[0]:
        quat = (largest, h - f, c - g, d - b)
    elif largest == squares[1]:
        quat = (h - f, largest, b + d, c + g)
    elif largest == squares[2]:
        quat = (c - g, b + d, largest, f + h)
    else:
        quat = (d - b, c + g, f + h, largest)
    scale = math.copysign(0.5 / math.sqrt(largest), quat[0])
    w, x, y, z = (scale * component for component in quat)
    return w, x, y, z


def _array(values: npt.ArrayLike, shape: tuple[int, ...], what: str) -> Floats:
    """Return a copy of `values` as an array of a given shape.

    Raises:
        GeometryError: The values are not numbers, not finite, or have another shape.
    """
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        raise GeometryError(f"The {what} must hold numbers in shape {shape}, got {values!r}.", shape=shape) from None
    if array.shape != shape:
        raise GeometryError(f"The {what} has shape {array.shape}, must be {shape}.", shape=array.shape, expected=shape)
    if not all(map(math.isfinite, array.ravel().tolist())):
        raise GeometryError(f"The {what} {array.tolist()} holds a number that is not finite.", values=array.tolist())
    return array


def _dot(one: Sequence[float], other: Sequence[float]) -> float:
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def _check_rotation(rotation: Floats) -> None:
    """Raise `GeometryError` unless a matrix (3, 3) is a rotation. Plain floats are faster here than numpy."""
    one, two, three = rotation.tolist()
    lengths = (abs(_dot(row, row) - 1.0) for row in (one, two, three))
    deviation = max(*lengths, abs(_dot(one, two)), abs(_dot(two, three)), abs(_dot(three, one)))
    (a, b, c), (d, e, f) = one, two
    determinant = _dot(three, (b * f - c * e, c * d - a * f, a * e - b * d))
    if deviation > ORTHONORMAL_TOLERANCE or determinant < 0.0:
        raise GeometryError(
            f"The matrix is not a rotation: R R^T differs from I by {deviation:.3g} (limit {ORTHONORMAL_TOLERANCE:g}), "
            f"determinant {determinant:.3g} (must be +1); orthonormalize it or check its handedness.",
            deviation=deviation,
            determinant=determinant,
            tolerance=ORTHONORMAL_TOLERANCE,
        )
