"""Convex shapes for coal."""

from __future__ import annotations

import coal
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import GeometryError
from pcmrs.kinematics.collision import Solid, box, capsule, cylinder, hull, pose_between
from pcmrs.spatial import Floats, Transform
from tests.unit.kinematics.zone_cell import CORNERS


def test_points_without_a_hull_are_refused() -> None:
    """Coal would read memory that is not its own where Qhull finds no hull."""
    sheet = np.random.default_rng(1).standard_normal((50, 3)) * (0.1, 0.1, 1e-9)
    broken = np.where(np.arange(24).reshape(8, 3) == 5, np.nan, CORNERS)
    for points in (CORNERS[:3], CORNERS[:4], np.zeros((0, 3)), np.zeros((9, 3)), sheet, broken):
        with pytest.raises(GeometryError, match="no convex hull"):
            hull(points)


places = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).map(np.array)
turns = st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3)
BALL = 0.01


def distance_to(solid: Solid, point: Floats) -> float:
    """Return the distance of a small ball at a point from a shape, m."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    ball = capsule(point, point, BALL)
    shapes = (solid.geometry, coal.Transform3s(solid.pose.rotation, solid.pose.translation))
    other = (ball.geometry, coal.Transform3s(ball.pose.rotation, ball.pose.translation))
    return float(coal.distance(*shapes, *other, request, result))


@given(places, places, places, st.floats(0.01, 0.2))
def test_a_capsule_is_all_within_a_radius_of_its_segment(start: Floats, end: Floats, point: Floats, r: float) -> None:
    line = end - start
    part = np.clip((point - start) @ line / max(float(line @ line), 1e-12), 0.0, 1.0)
    expected = np.linalg.norm(point - start - part * line) - r - BALL
    if expected > 1e-3:
        assert distance_to(capsule(start, end, r), point) == pytest.approx(expected, abs=1e-6)


@given(places, turns, places)
def test_a_box_is_turned_and_placed_with_its_frame(place: Floats, turn: list[float], point: Floats) -> None:
    pose, half = Transform.from_rotvec(place, turn), np.array((0.1, 0.2, 0.05))
    expected = np.linalg.norm(np.maximum(np.abs(pose.inverse() @ point) - half, 0.0)) - BALL
    if expected > 1e-3:
        assert distance_to(box(2.0 * half, pose), point) == pytest.approx(expected, abs=1e-6)


@given(places, st.floats(0.02, 0.3), st.floats(0.02, 0.3), st.floats(-0.5, 0.5))
def test_a_cylinder_stands_on_the_z_axis(point: Floats, radius: float, half: float, middle: float) -> None:
    beside = max(np.hypot(point[0], point[1]) - radius, 0.0)
    expected = np.hypot(beside, max(abs(point[2] - middle) - half, 0.0)) - BALL
    if expected > 1e-3:
        assert distance_to(cylinder(radius, half, middle), point) == pytest.approx(expected, abs=1e-5)


@given(places, places)
def test_a_frame_between_two_points_looks_from_one_to_the_other(start: Floats, end: Floats) -> None:
    pose, length = pose_between(start, end), float(np.linalg.norm(end - start))
    np.testing.assert_allclose(pose.translation, (start + end) / 2.0)
    np.testing.assert_allclose(pose.rotation.T @ pose.rotation, np.eye(3), atol=1e-9)
    if length > 1e-6:
        np.testing.assert_allclose(length * pose.rotation[:, 2], end - start, atol=1e-9)
