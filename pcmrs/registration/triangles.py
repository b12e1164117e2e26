"""Nearest points on a triangulated surface, exactly and for many points at once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError
from pcmrs.spatial import Floats

__all__ = ["TriangleSurface", "closest_on_triangles"]

Ints = npt.NDArray[np.int64]
_EDGE = 1e-9
"""Tolerance of barycentric coordinates, so that a ray through the edge between two triangles meets both, not none; and
of a cosine, so that a ray along a triangle does not exit through it."""


class TriangleSurface:
    """A triangulated surface with queries for nearest points.

    Args:
        vertices: Vertices, m, (V, 3).
        faces: Indices of the corners, counter-clockwise seen from outside, (F, 3). Triangles without area are ignored.

    Raises:
        GeometryError: Shapes are wrong, an index is out of range, a number is not finite, or no triangle has an area.
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
        self._largest_radius = float(np.linalg.norm(self._corners - middles[:, None], axis=2).max())

    def distance_bounds(self, points: Floats) -> Floats:
        """Return upper bounds of the distances of points (K, 3) from the surface, m, (K,).

        Each is the distance to a near triangle, so never less than the distance to the nearest one.
        """
        found: Floats = np.linalg.norm(self.near(points)[0] - points, axis=1)
        return found

    def near(self, points: Floats) -> tuple[Floats, Floats]:
        """Return near points of the surface and its outward unit normals there, (K, 3) each, in one query per point.

        They are on the triangle whose middle is nearest, which is the nearest triangle or one beside it. That is enough
        for a direction, and takes no memory for points that are far away.

        Args:
            points: Points, m, (K, 3).
        """
        _, nearest = self._tree.query(points)
        triangles = np.asarray(nearest, dtype=np.int64)
        found = closest_on_triangles(points, self._corners[triangles])
        return found, self._normals(found, triangles)

    def facets(self) -> tuple[Floats, Floats, Floats]:
        """Return the middles of all triangles, m, (F, 3), their outward unit normals, (F, 3), and areas, m^2, (F,)."""
        crosses = np.cross(self._corners[:, 1] - self._corners[:, 0], self._corners[:, 2] - self._corners[:, 0]) / 2.0
        return self._corners.mean(axis=1), _unit(crosses), np.linalg.norm(crosses, axis=1)

    def closest(self, points: Floats) -> tuple[Floats, Floats]:
        """Return the nearest points of the surface, and its unit normals there, interpolated between the corners.

        A nearer triangle has its middle within the bound on the distance plus the largest distance of a middle from its
        corners, so that no other triangle has to be examined.

        Args:
            points: Points, m, (K, 3).

        Returns:
            Nearest points, m, (K, 3), and outward unit normals, (K, 3), which turn smoothly from triangle to triangle.
        """
        radii = self.distance_bounds(points) * (1.0 + 1e-9) + self._largest_radius
        near = self._tree.query_ball_point(points, radii)
        counts = np.array([len(indices) for indices in near])
        candidates = np.concatenate([np.asarray(indices, dtype=np.int64) for indices in near])
        queries = np.repeat(np.arange(len(points)), counts)
        found = closest_on_triangles(points[queries], self._corners[candidates])
        squared = np.sum((found - points[queries]) ** 2, axis=1)
        # Sorted by point, then by distance: the first of each point is its nearest.
        best = np.lexsort((candidates, squared, queries))[np.concatenate(([0], np.cumsum(counts)[:-1]))]
        return found[best], self._normals(found[best], candidates[best])

    def exit_point(self, start: Floats, direction: Floats) -> Floats | None:
        """Return the point at which a ray first leaves the surface, m, (3,), or None.

        T. Möller, B. Trumbore, J. Graph. Tools 2 (1997) 21, for all triangles at once.

        Args:
            start: Start of the ray, m, (3,).
            direction: Direction of the ray, of any length but zero, (3,).
        """
        ray = direction / np.linalg.norm(direction)
        sides = self._corners[:, 1:] - self._corners[:, :1]
        normals = np.cross(sides[:, 0], sides[:, 1])
        # A ray can only leave through triangles that face along it.
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
    """Return the point of each triangle that is nearest to the point of the same row, m, (K, 3).

    It is the foot of the perpendicular if that lies in the triangle, otherwise the nearest point of the three sides
    (C. Ericson, Real-Time Collision Detection, 2005, sections 3.4 and 5.1).

    Args:
        points: Points, m, (K, 3).
        corners: Corners of the triangles, m, (K, 3, 3).
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
    """Return the unit normal at each corner of each triangle, (F, 3, 3).

    It is the area-weighted mean of the normals of the triangles that meet there.
    """
    sums = np.zeros((faces.max() + 1, 3))
    np.add.at(sums, faces, crosses[:, None])
    found: Floats = _unit(sums)[faces]
    return found


def _unit(vectors: Floats) -> Floats:
    """Return vectors (K, 3) scaled to length one.

    Zero stays zero: on an edge where a sheet turns back there is no normal.
    """
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit: Floats = vectors / np.where(lengths > 0.0, lengths, 1.0)
    return unit


def _barycentric(points: Floats, corners: Floats) -> Floats:
    """Return the barycentric coordinates of points (K, 3) in their triangles with corners (K, 3, 3), (K, 3).

    They are shares of the area of the triangle.
    """
    offsets = corners - points[:, None]
    areas = np.linalg.norm(np.cross(np.roll(offsets, -1, axis=1), np.roll(offsets, -2, axis=1)), axis=2)
    shares: Floats = areas / areas.sum(axis=1, keepdims=True)
    return shares


def _corners(vertices: Floats, faces: npt.NDArray[np.generic]) -> Floats:
    """Return the corners of all triangles, m, (F, 3, 3). Raises `GeometryError` if the surface is malformed."""
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
