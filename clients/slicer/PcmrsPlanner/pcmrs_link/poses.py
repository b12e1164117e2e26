"""Rigid poses in the image (RAS, mm), from what a scene holds: matrices and lines."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

TOLERANCE = 1e-4
"""Greatest deviation of R R^T from I: what single precision and a chain of products leave, 0.006 degrees."""

UNIT = 1e-3
"""Greatest deviation of a quaternion's length from 1: far more than 5 decimals leave."""

ANTERIOR = (0.0, 1.0, 0.0)
SUPERIOR = (0.0, 0.0, 1.0)

Vector = tuple[float, ...]


class PoseError(ValueError):
    """What is given is no rigid pose."""


@dataclass(frozen=True)
class Pose:
    """A pose: position in mm, (3,), and unit quaternion x y z w."""

    position: Vector
    quat_xyzw: Vector

    @classmethod
    def near(cls, position: Sequence[float], quat_xyzw: Sequence[float]) -> Pose:
        """The pose whose quaternion is rounded.

        Raises:
            PoseError: The quaternion is far from a unit one.
        """
        length = math.sqrt(math.fsum(part * part for part in quat_xyzw))
        if not abs(length - 1.0) <= UNIT:
            raise PoseError(f"The quaternion has length {length:g}, not 1.")
        return cls(tuple(position), tuple(part / length for part in quat_xyzw))

    @property
    def matrix(self) -> list[Vector]:
        """Rows of the homogeneous matrix, (4, 4), mm."""
        x, y, z, w = self.quat_xyzw
        px, py, pz = self.position
        return [
            (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), px),
            (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), py),
            (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), pz),
            (0.0, 0.0, 0.0, 1.0),
        ]


def pose_of_matrix(rows: Sequence[Sequence[float]]) -> Pose:
    """The pose of a homogeneous matrix, (4, 4), mm.

    Raises:
        PoseError: It holds a number that is not finite, scales, shears or mirrors.
    """
    if not all(math.isfinite(value) for row in rows for value in row):
        raise PoseError("The transform holds a number that is not finite.")
    columns = [tuple(float(row[axis]) for row in rows[:3]) for axis in range(3)]
    products = [abs(_dot(columns[i], columns[j]) - float(i == j)) for i in range(3) for j in range(i, 3)]
    if max(products) > TOLERANCE:
        raise PoseError("The transform scales or shears; the tool's pose has to be rigid.")
    if _dot(_cross(columns[0], columns[1]), columns[2]) < 0.0:
        raise PoseError("The transform mirrors; the tool's pose has to be rigid.")
    return Pose(tuple(float(row[3]) for row in rows[:3]), _quaternion(columns))


def pose_of_line(target: Sequence[float], away: Sequence[float], turn: float = 0.0) -> Pose:
    """The tool at a target, +z towards another point, mm, which lies away from the body.

    Args:
        target: Where the tool is to touch, (3,).
        away: A point on the tool's axis, away from the body, (3,).
        turn: About that axis, rad; at 0 the tool's +y points as far anterior as it can, or superior if it cannot.

    Raises:
        PoseError: The points are less than 1 mm apart, or not finite.
    """
    axis = _minus(away, target)
    if not _length(axis) >= 1.0:
        raise PoseError("The two points of the tool's axis have to be 1 mm apart or more.")
    z = _unit(axis)
    hint = ANTERIOR if abs(_dot(ANTERIOR, z)) < 0.9 else SUPERIOR
    x = _unit(_cross(hint, z))
    y = _cross(z, x)
    cosine, sine = math.cos(turn), math.sin(turn)
    turned_x = tuple(cosine * x[i] + sine * y[i] for i in range(3))
    turned_y = tuple(cosine * y[i] - sine * x[i] for i in range(3))
    return Pose(tuple(map(float, target)), _quaternion([turned_x, turned_y, z]))


def _quaternion(columns: Sequence[Vector]) -> Vector:
    """Of a rotation, by its largest part (Shepperd, Quaternion from Rotation Matrix, 1978)."""
    (a, b, c), (d, e, f), (g, h, i) = columns
    candidates = [
        (1 + a - e - i, d + b, g + c, f - h),
        (d + b, 1 - a + e - i, h + f, g - c),
        (g + c, h + f, 1 - a - e + i, b - d),
        (f - h, g - c, b - d, 1 + a + e + i),
    ]
    return _unit(max(candidates, key=_length))


def _dot(first: Sequence[float], second: Sequence[float]) -> float:
    return math.fsum(first[i] * second[i] for i in range(3))


def _cross(first: Sequence[float], second: Sequence[float]) -> Vector:
    (a, b, c), (d, e, f) = first, second
    return (b * f - c * e, c * d - a * f, a * e - b * d)


def _minus(first: Sequence[float], second: Sequence[float]) -> Vector:
    return tuple(float(first[i]) - float(second[i]) for i in range(3))


def _length(vector: Sequence[float]) -> float:
    return math.sqrt(math.fsum(part * part for part in vector))


def _unit(vector: Sequence[float]) -> Vector:
    length = _length(vector)
    return tuple(part / length for part in vector)
