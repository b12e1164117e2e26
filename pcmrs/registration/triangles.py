"""The point of a triangulated surface that is nearest to another point, exactly, for many points at once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError
from pcmrs.spatial import Floats

Ints = npt.NDArray[np.int64]
_EDGE = 1e-9
"""Of a triangle's shares: a ray through the edge between two of them meets both, not none; and of a cosine: one along a
triangle does not leave by it."""


class TriangleSurface:
    """A triangulated surface that can be asked for nearest points.

    Args:
        vertices: m, (V, 3).
        faces: Indices of the corners, counter-clockwise seen from outside, (F, 3); triangles without area are left out.

    Raises:
        GeometryError: Shapes are wrong, an index leads nowhere, a number is not finite, or no triangle has an area.
    """

    def __init__(self, vertices: npt.ArrayLike, faces: npt.ArrayLike) -> None:
        corners = _corners(np.asarray(vertices, dtype=float), np.asarray(faces))
        crosses = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.linalg.norm(crosses, axis=1)
        solid = areas > 0.0
        if not solid.any():
            raise GeometryError("The surface has no triangle with an area; give a surface.", faces=len(areas))
        self._corners = corners[solid]
        self._corner_normals = _vertex_normals(np.asarray(faces, dtype=np.int64), crosses)[solid]
        middles = self._corners.mean(axis=1)
        from scipy.spatial import cKDTree  # takes longer to load than all else here; the daemon needs no tree

        self._tree = cKDTree(middles)
        self._reach = float(np.linalg.norm(self._corners - middles[:, None], axis=2).max())

    def reach(self, points: Floats) -> Floats:
        """Distances of points (K, 3) to a near point of the surface, m, (K,): never below those to the nearest."""
        _, near = self._tree.query(points)
        found: Floats = np.linalg.norm(closest_on_triangles(points, self._corners[near]) - points, axis=1)
        return found

    def closest(self, points: Floats) -> tuple[Floats, Floats]:
        """The nearest points of the surface, and its unit normals there, interpolated between the corners.

        A triangle as near as one already found has its middle within that distance and the largest distance from
        a middle to its corners, so no other need be looked at.

        Args:
            points: m, (K, 3).

        Returns:
            Nearest points, m, (K, 3), and outward normals, (K, 3): they turn smoothly from triangle to triangle.
        """
        radii = self.reach(points) * (1.0 + 1e-9) + self._reach
        near = self._tree.query_ball_point(points, radii)
        counts = np.array([len(indices) for indices in near])
        candidates = np.concatenate([np.asarray(indices, dtype=np.int64) for indices in near])
        asking = np.repeat(np.arange(len(points)), counts)
        found = closest_on_triangles(points[asking], self._corners[candidates])
        squared = np.sum((found - points[asking]) ** 2, axis=1)
        # Sorted by point, then by distance: the first of each point is its nearest.
        best = np.lexsort((candidates, squared, asking))[np.concatenate(([0], np.cumsum(counts)[:-1]))]
        return found[best], self._normals(found[best], candidates[best])

    def leaving(self, start: Floats, direction: Floats) -> Floats | None:
        """Where a ray from a point first comes out of the surface, m, (3,); None where it never does.

        T. Möller, B. Trumbore, J. Graph. Tools 2 (1997) 21, for all triangles at once.

        Args:
            start: m, (3,).
            direction: Of any length but zero, (3,).
        """
        ray = direction / np.linalg.norm(direction)
        sides = self._corners[:, 1:] - self._corners[:, :1]
        normals = np.cross(sides[:, 0], sides[:, 1])
        out = normals @ ray > _EDGE * np.linalg.norm(normals, axis=1)
        first, second = sides[out].transpose(1, 0, 2)
        volumes, offsets = normals[out] @ ray, self._corners[out, 0] - start
        turned = np.cross(offsets, ray)
        u, v = np.sum(second * turned, axis=1) / volumes, -np.sum(first * turned, axis=1) / volumes
        along = np.sum(offsets * normals[out], axis=1) / volumes
        met = (u >= -_EDGE) & (v >= -_EDGE) & (u + v <= 1.0 + _EDGE) & (along >= 0.0)
        return start + along[met].min() * ray if met.any() else None

    def _normals(self, points: Floats, triangles: Ints) -> Floats:
        shares = _barycentric(points, self._corners[triangles])
        normals = np.einsum("kc,kci->ki", shares, self._corner_normals[triangles])
        return _unit(normals)


def closest_on_triangles(points: Floats, corners: Floats) -> Floats:
    """The point of each triangle that is nearest to the point of the same row, (K, 3).

    The foot of the perpendicular where it lies in the triangle, else the nearest point of the three sides
    (C. Ericson, Real-Time Collision Detection, 2005, sections 3.4 and 5.1).

    Args:
        points: m, (K, 3).
        corners: m, (K, 3, 3).
    """
    sides = np.roll(corners, -1, axis=1) - corners
    offsets = points[:, None] - corners
    lengths = np.sum(sides**2, axis=2)
    along = np.clip(np.sum(offsets * sides, axis=2) / np.where(lengths > 0.0, lengths, 1.0), 0.0, 1.0)
    on_sides = corners + along[..., None] * sides
    nearest = np.argmin(np.sum((on_sides - points[:, None]) ** 2, axis=2), axis=1)
    normals = np.cross(sides[:, 0], sides[:, 1])
    within = np.all(np.sum(np.cross(normals[:, None], sides) * offsets, axis=2) >= 0.0, axis=1)
    heights = np.sum(offsets[:, 0] * normals, axis=1) / np.maximum(np.sum(normals**2, axis=1), np.finfo(float).tiny)
    feet = points - heights[:, None] * normals
    found: Floats = np.where(within[:, None], feet, on_sides[np.arange(len(points)), nearest])
    return found


def _vertex_normals(faces: Ints, crosses: Floats) -> Floats:
    """The unit normal at each corner of each triangle, (F, 3, 3): the mean of those that meet there, by area."""
    sums = np.zeros((faces.max() + 1, 3))
    np.add.at(sums, faces, crosses[:, None])
    found: Floats = _unit(sums)[faces]
    return found


def _unit(vectors: Floats) -> Floats:
    """Vectors (K, 3) made one long; zero stays zero, as on an edge where a sheet turns back: it has no normal."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit: Floats = vectors / np.where(lengths > 0.0, lengths, 1.0)
    return unit


def _barycentric(points: Floats, corners: Floats) -> Floats:
    """The shares of the corners (K, 3, 3) in points of their triangles (K, 3), (K, 3): parts of the area."""
    offsets = corners - points[:, None]
    areas = np.linalg.norm(np.cross(np.roll(offsets, -1, axis=1), np.roll(offsets, -2, axis=1)), axis=2)
    shares: Floats = areas / areas.sum(axis=1, keepdims=True)
    return shares


def _corners(vertices: Floats, faces: npt.NDArray[np.generic]) -> Floats:
    if vertices.ndim != 2 or vertices.shape[1] != 3 or faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise GeometryError(
            f"A surface needs vertices (V, 3) and faces (F, 3), not {vertices.shape} and {faces.shape}.",
            vertices=vertices.shape,
            faces=faces.shape,
        )
    indices: Ints = faces.astype(np.int64)
    if not 0 <= indices.min() <= indices.max() < len(vertices):
        raise GeometryError(
            f"A face names vertex {indices.min()} or {indices.max()}, but there are {len(vertices)}; export it again.",
            count=len(vertices),
        )
    corners: Floats = vertices[indices]
    if not np.isfinite(corners).all():
        raise GeometryError("The surface holds a number that is not finite; export it again.")
    return corners
