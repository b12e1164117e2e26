"""Nearest points of a triangulated surface against a search of all triangles by another method."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from pcmrs.registration.triangles import TriangleSurface, closest_on_triangles
from pcmrs.spatial import Floats

seeds = st.integers(0, 2**32 - 1)


def nearest_of_all(point: Floats, corners: Floats) -> float:
    """Distance to the nearest of triangles (F, 3, 3), over a dense lattice of each."""
    steps = [(a, b) for a in np.linspace(0, 1, 60) for b in np.linspace(0, 1, 60) if a + b <= 1 + 1e-12]
    shares = np.array([(1 - a - b, a, b) for a, b in steps])
    return float(np.linalg.norm(np.einsum("sc,fci->fsi", shares, corners) - point, axis=2).min())


@given(seeds)
def test_the_point_of_a_triangle_is_the_nearest(seed: int) -> None:
    """Least squares over two sides with bounds gives the answer within the parallelogram; the rest is its border."""
    rng = np.random.default_rng(seed)
    point, corners = rng.normal(size=3), rng.normal(size=(3, 3))
    (found,) = closest_on_triangles(point[None], corners[None])
    shares, *_ = np.linalg.lstsq(np.vstack((corners.T, np.ones(3))), np.append(found, 1.0), rcond=None)
    assert shares.min() > -1e-9  # it is a point of the triangle
    assert shares.sum() - 1.0 < 1e-9
    best = min(
        float(np.linalg.norm(point - _nearest_with_one_corner_fixed(point, np.roll(corners, turn, axis=0))))
        for turn in range(3)
    )
    assert np.linalg.norm(found - point) <= best + 1e-9


def _nearest_with_one_corner_fixed(point: Floats, corners: Floats) -> Floats:
    """A good point of the triangle: the bounded least squares, pushed back along the side where it overshoots."""
    sides = (corners[1:] - corners[0]).T
    shares = lsq_linear(sides, point - corners[0], bounds=(0.0, 1.0)).x
    return np.asarray(corners[0] + sides @ (shares / max(1.0, shares.sum())))


@given(seeds)
def test_the_nearest_triangle_of_uneven_ones_is_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = 10.0 ** rng.uniform(-2, 1, (12, 1, 1))
    corners = rng.normal(size=(12, 1, 3)) + sizes * rng.normal(size=(12, 3, 3))
    surface = TriangleSurface(corners.reshape(-1, 3), np.arange(36).reshape(-1, 3))
    points = 2.0 * rng.normal(size=(5, 3))
    found, normals = surface.closest(points)
    distances = np.linalg.norm(found - points, axis=1)
    all_of_them = [
        np.linalg.norm(closest_on_triangles(np.tile(point, (12, 1)), corners) - point, axis=1).min() for point in points
    ]
    np.testing.assert_allclose(distances, all_of_them, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    assert (surface.distance_bounds(points) >= distances - 1e-12).all()
    near, turned = surface.near(points)
    np.testing.assert_allclose(np.linalg.norm(near - points, axis=1), surface.distance_bounds(points))
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), 1.0)


def test_a_lattice_of_points_is_nowhere_nearer() -> None:
    rng = np.random.default_rng(0)
    corners, points = rng.normal(size=(6, 3, 3)), 2.0 * rng.normal(size=(20, 3))
    surface = TriangleSurface(corners.reshape(-1, 3), np.arange(18).reshape(-1, 3))
    found, _ = surface.closest(points)
    for point, nearest in zip(points, found, strict=True):
        lattice = nearest_of_all(point, corners)
        assert lattice - 0.1 < np.linalg.norm(nearest - point) <= lattice + 1e-12


def test_triangles_without_area_are_left_out() -> None:
    vertices = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 0.5)], dtype=float)
    surface = TriangleSurface(vertices, [(0, 1, 2), (0, 3, 3)])
    found, normals = surface.closest(np.array([(0.2, 0.2, 0.6)]))
    np.testing.assert_allclose(found, [(0.2, 0.2, 0.0)])
    np.testing.assert_allclose(normals, [(0.0, 0.0, 1.0)])


def test_facets_of_a_closed_surface_add_up() -> None:
    """The areas are those of a tetrahedron, and the areas times normals cancel (divergence theorem)."""
    vertices = np.array([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
    faces = np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])
    middles, normals, areas = TriangleSurface(vertices, faces).facets()
    np.testing.assert_allclose(areas, [0.5, 0.5, 0.5, np.sqrt(3.0) / 2.0])
    np.testing.assert_allclose(areas @ normals, 0.0, atol=1e-12)
    assert np.sum(areas * np.sum(middles * normals, axis=1)) / 3.0 > 0.0
