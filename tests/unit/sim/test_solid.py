"""Depth of the phantoms beyond a round face."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs_sim import femur, head
from pcmrs_sim.plan import trajectory

directions = st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3).filter(lambda v: float(np.linalg.norm(v)) > 0.1)


@given(directions, st.floats(-0.01, 0.01))
def test_a_face_at_the_scalp_reaches_as_deep_as_it_was_put(direction: list[float], depth: float) -> None:
    point = head.surface_point(direction)
    normal = head.outward_normal(point)
    touch = head.HEAD.solid.touch(point - depth * normal, normal, head.COIL_RADIUS)
    if depth <= 0.0:
        assert touch is None or touch.depth < 1e-9
    elif depth > 1e-9:
        assert touch is not None
        assert touch.depth == pytest.approx(depth, abs=1e-9)
        assert np.allclose(touch.point, point, atol=2e-4)


@given(directions, st.floats(0.001, 0.01))
def test_no_point_of_the_head_lies_deeper_than_its_touch(direction: list[float], depth: float) -> None:
    axis = np.array(direction) / np.linalg.norm(direction)
    rays = np.random.default_rng(0).normal(size=(300, 3))
    surface = np.array([head.surface_point(ray) for ray in rays])
    touch = head.HEAD.solid.touch(head.CENTRE, axis, 1.0)
    assert touch is not None
    assert ((surface - head.CENTRE) @ axis).max() <= touch.depth + 1e-12


@pytest.mark.parametrize(("depth_percent", "inferior", "posterior"), [(0.45, 20, 8), (0.55, 16, 4), (0.65, 30, 12)])
def test_a_guide_touches_the_bone_at_the_planned_entry(depth_percent: float, inferior: float, posterior: float) -> None:
    entry, target = trajectory(depth_percent, inferior, posterior)
    axis = (entry - target) / np.linalg.norm(entry - target)
    clear = femur.FEMUR.solid.touch(entry + 0.006 * axis, axis, femur.GUIDE_RADIUS)
    assert clear is None or clear.depth < 0.006, "a sleeve of 6 mm meets the slope of the bone a little before its axis"
    inside = femur.FEMUR.solid.touch(entry - 0.003 * axis, axis, femur.GUIDE_RADIUS)
    assert inside is not None
    assert 0.003 - 1e-4 < inside.depth < 0.003 + 0.006


@pytest.mark.parametrize("seed", range(20))
def test_a_point_is_in_the_balls_where_it_is_in_the_bone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    origin = femur.BASE + rng.uniform(-0.05, 0.05, 3)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    touch = femur.FEMUR.solid.touch(origin, axis, 1e-9)
    along = np.linspace(0.0, 0.25, 1000)
    ahead = femur.distances(origin + along[:, None] * axis)
    inside = np.flatnonzero(ahead < 0.0)
    if touch is None:
        assert ahead.min() > -1e-4
    elif len(inside):
        assert touch.depth == pytest.approx(along[inside[-1]], abs=6e-4)


def test_beside_the_face_there_is_no_touch() -> None:
    solid, crown = head.HEAD.solid, head.surface_point((0.0, 0.0, 1.0))
    inward = np.array([0.0, 0.0, -0.005])
    assert solid.touch(crown + inward + np.array([0.049, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0.05) is not None
    assert solid.touch(crown + inward + np.array([0.051, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0.05) is None
