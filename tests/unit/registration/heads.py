"""Two heads whose points can be touched with hair between tip and skin: the shipped phantom, and an uneven one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull

from pcmrs.registration import register_points
from pcmrs.registration._surface_fit import hair_side, widest_middle
from pcmrs.spatial import Floats, Transform
from pcmrs_sim import head, surfaces

SIGMA, SIGMA_SURFACE = 1.86e-3, 0.5e-3
TRUTH = Transform.from_rotvec((0.1, -0.2, 0.05), (0.3, 2.0, -0.7))
STEP = 1e-6
UNDER_THE_SCALP = np.array((0.03, 0.0, 0.08))


@dataclass(frozen=True, eq=False)
class TouchedHead:
    """A closed surface around a centre.

    Attributes:
        centre: Centre in the image, m, (3,).
        radius: Distance of the surface from the centre in unit directions (K, 3), m, (K,).
        landmarks: Landmarks in the image, m, (N, 3).
        vertices: Vertices of its mesh, m, (V, 3).
        faces: Triangles, (F, 3).
        target: Point under the scalp at which the error counts, m, (3,).
    """

    centre: Floats
    radius: Callable[[Floats], Floats]
    landmarks: Floats
    vertices: Floats
    faces: npt.NDArray[np.int64]
    target: Floats

    def points(self, directions: Floats) -> Floats:
        unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        found: Floats = self.centre + unit * self.radius(unit)[:, None]
        return found

    def normals(self, points: Floats) -> Floats:
        """Gradient of the implicit function |p| / r(p / |p|), by central differences."""
        gradient = np.stack(
            [(self._level(points + step) - self._level(points - step)) for step in STEP * np.eye(3)], axis=1
        )
        normals: Floats = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
        return normals

    def _level(self, points: Floats) -> Floats:
        lengths = np.linalg.norm(points - self.centre, axis=1)
        level: Floats = lengths / self.radius((points - self.centre) / lengths[:, None])
        return level

    def touched(self, directions: Floats, rng: np.random.Generator, hair: float, face: float) -> Floats:
        """Points in body_ref, m, with the offsets of hair and face, m, and noise."""
        points = self.points(directions)
        offsets = np.where(hair_side(points, widest_middle(self.vertices)), hair, face)
        touched: Floats = TRUTH @ (points + offsets[:, None] * self.normals(points))
        return touched + rng.normal(0.0, SIGMA_SURFACE, points.shape)

    def session(
        self, seed: int, *, count: int = 100, hair: float = 0.002, face: float = 0.0, **given: Any
    ) -> dict[str, Any]:
        """Arguments of `refine_with_surface` for a simulated session; `given` replaces some of them."""
        rng = np.random.default_rng(seed)
        digitized = TRUTH @ self.landmarks + rng.normal(0.0, SIGMA, self.landmarks.shape)
        return {
            "registration": register_points(digitized, self.landmarks).fixed_from_moving,
            "landmarks_image": self.landmarks,
            "landmarks_body_ref": digitized,
            "sigma": SIGMA,
            "vertices": self.vertices,
            "faces": self.faces,
            "points_body_ref": self.touched(reachable(rng, count), rng, hair, face),
            "sigma_surface": SIGMA_SURFACE,
            "target": self.target,
        } | given

    def error(self, found: Transform) -> float:
        return float(np.linalg.norm(found @ self.target - TRUTH @ self.target))


def reachable(rng: np.random.Generator, count: int) -> Floats:
    """Unit directions to the top of the head and to the face, where `pcmrs_sim.phantoms` touches, too."""
    found = rng.normal(size=(20 * count, 3))
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return found[(found[:, 2] > 0.2) | (found[:, 1] > 0.5)][:count]


def evenly(count: int) -> Floats:
    """Directions spread over the sphere (Fibonacci lattice)."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    angle = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    around = np.sqrt(1.0 - z**2)
    return np.column_stack((around * np.cos(angle), around * np.sin(angle), z))


def _phantom() -> TouchedHead:
    def radius(unit: Floats) -> Floats:
        powers: Floats = np.sum(np.abs(unit / head.SEMI_AXES) ** head.EXPONENT, axis=1)
        return powers ** (-1.0 / head.EXPONENT)

    landmarks = np.array([landmark.position for landmark in head.LANDMARKS])
    return TouchedHead(head.CENTRE, radius, landmarks, *surfaces.head_surface(), head.CENTRE + UNDER_THE_SCALP)


def _uneven() -> TouchedHead:
    """An ellipsoid with a nose, a back of the head that is wider on the left, and flat temples."""
    semi_axes = np.array((0.074, 0.094, 0.112))
    bumps = [
        ((0.0, 0.95, -0.3), 0.12, 0.15),
        ((-0.3, -0.9, 0.3), 0.06, 0.5),
        ((0.9, 0.4, 0.1), -0.04, 0.3),
        ((-0.9, 0.4, 0.1), -0.04, 0.3),
        ((0.5, -0.2, 0.8), 0.03, 0.4),
    ]

    def radius(unit: Floats) -> Floats:
        found: Floats = 1.0 / np.sqrt(np.sum((unit / semi_axes) ** 2, axis=1))
        shape = np.ones(len(unit))
        for at, height, width in bumps:
            shape += height * np.exp(-np.sum((unit - at) ** 2, axis=1) / (2.0 * width**2))
        return found * shape

    directions = evenly(5000)
    faces = ConvexHull(directions).simplices.astype(np.int64)
    a, b, c = np.moveaxis(directions[faces], 1, 0)
    inwards = np.sum(np.cross(b - a, c - a) * a, axis=1) < 0.0
    faces[inwards] = faces[inwards][:, ::-1]
    centre = np.array((-0.003, 0.008, 0.02))
    marks = np.array(
        [(0, 1, 0.05), (0, 0.95, -0.3), (-0.52, 0.85, 0), (0.52, 0.85, 0), (-1, 0.05, -0.2), (1, 0.05, -0.2)]
    )
    marks /= np.linalg.norm(marks, axis=1, keepdims=True)
    vertices = centre + directions * radius(directions)[:, None]
    landmarks = centre + marks * radius(marks)[:, None]
    return TouchedHead(centre, radius, landmarks, vertices, faces, centre + UNDER_THE_SCALP)


HEADS = {"phantom": _phantom(), "uneven": _uneven()}
