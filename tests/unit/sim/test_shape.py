"""Capsules and their primitives, against a dense row of spheres."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.spatial import Floats
from pcmrs_sim.shape import Capsule, rotation_with_z

coordinate = st.floats(-1.0, 1.0)
points = st.tuples(coordinate, coordinate, coordinate).map(np.array)
directions = points.filter(lambda v: float(np.linalg.norm(v)) > 1e-3)


@given(points, points, points)
def test_the_distance_is_that_of_the_nearest_point_of_the_line(start: Floats, end: Floats, point: Floats) -> None:
    capsule = Capsule(start, end, 0.3)
    line = np.linspace(start, end, 2001)
    nearest = float(np.linalg.norm(line - point, axis=1).min()) - 0.3
    assert nearest - 1e-3 <= capsule.distance(point) <= nearest + 1e-12
    assert capsule.distance(np.stack((point, start)))[0] == pytest.approx(capsule.distance(point), abs=1e-12)


@given(points, points)
def test_a_line_without_length_is_a_sphere(centre: Floats, point: Floats) -> None:
    sphere = Capsule(centre, centre, 0.2)
    assert sphere.distance(point) == pytest.approx(float(np.linalg.norm(point - centre)) - 0.2)
    assert (sphere.shape().kind, sphere.shape().size) == ("ellipsoid", (0.2, 0.2, 0.2))


@given(points, directions)
def test_the_primitive_has_the_ends_of_the_line_on_its_axis(start: Floats, line: Floats) -> None:
    shape = Capsule(start, start + line, 0.1).shape(mass=0.5)
    radius, half = shape.size
    assert (shape.kind, radius, shape.mass) == ("capsule", 0.1, 0.5)
    assert shape.pose @ np.array([0.0, 0.0, -half]) == pytest.approx(start, abs=1e-9)
    assert shape.pose @ np.array([0.0, 0.0, half]) == pytest.approx(start + line, abs=1e-9)


@given(directions)
def test_the_rotation_turns_z_into_the_direction(direction: Floats) -> None:
    rotation = rotation_with_z(direction)
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert rotation[:, 2] * np.linalg.norm(direction) == pytest.approx(direction)
