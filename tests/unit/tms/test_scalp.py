"""Poses of a coil on the scalp: along it, tangent to it, and over the hand area."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import GeometryError
from pcmrs.spatial import Transform, rotation_angle
from pcmrs.tms.hotspot import HotspotSearch
from pcmrs.tms.scalp import along_scalp, hand_area, heading, on_scalp, turned
from pcmrs.tms.settings import HotspotSettings
from tests.unit.tms.heads import RADIUS, TOP, sphere

lengths = st.floats(-0.05, 0.05)


def _unit(x: float, y: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.array((x, y)) / math.hypot(x, y)


@given(lengths, lengths, st.floats(-3.0, 3.0))
def test_a_walk_on_a_sphere_follows_its_great_circle(x: float, y: float, angle: float) -> None:
    """Rotating the whole sphere about the axis across the way carries the coil along without a turn of its handle."""
    start = turned(TOP, angle)
    (found,) = along_scalp(sphere, start, [[x, y]])
    axis = np.cross((0.0, 0.0, 1.0), start.rotation @ np.array((x, y, 0.0)))
    # Each step is along the tangent, whose angle is smaller than its length says, by at most 1 in 5000.
    expected = Transform.from_rotvec((0.0, 0.0, 0.0), axis / RADIUS) @ start
    assert np.linalg.norm(found.translation - expected.translation) < 2e-5
    assert rotation_angle(found, expected) < 3e-4


def test_pose_beside_the_scalp_is_moved_onto_it_with_least_tilt() -> None:
    beside = Transform.from_rotvec((0.001, 0.0, RADIUS + 0.01), (0.2, 0.0, 0.7))
    placed = on_scalp(sphere, beside)
    assert np.linalg.norm(placed.translation) == pytest.approx(RADIUS)
    assert np.allclose(placed.rotation[:, 2], placed.translation / RADIUS)
    cosine = beside.rotation[:, 2] @ placed.rotation[:, 2]
    assert rotation_angle(beside, placed) == pytest.approx(np.arccos(cosine))


@pytest.mark.parametrize(("side", "sign"), [("right", 1.0), ("left", -1.0)])
def test_hand_area_is_beside_the_vertex_with_handle_back_and_out(side: str, sign: float) -> None:
    pose = hand_area(sphere, TOP.translation, "right" if side == "right" else "left")
    away = RADIUS * np.arccos(pose.translation[2] / RADIUS)
    assert away == pytest.approx(np.hypot(0.055, 0.005), rel=1e-3)
    assert sign * pose.translation[0] > 0.05 * 0.9
    handle = -pose.rotation[:, 1]
    assert sign * handle[0] > 0.3
    assert handle[1] < -0.6


@given(st.floats(-3.1, 3.1), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_the_heading_is_the_turn_about_the_normal(angle: float, tilt_x: float, tilt_y: float) -> None:
    tilt = Transform.from_rotvec((0.0, 0.0, 0.0), (tilt_x, tilt_y, 0.0))
    assert heading(TOP, tilt @ turned(TOP, angle)) == pytest.approx(angle, abs=1e-9)


def test_upside_down_coil_and_invalid_offsets_are_refused() -> None:
    flipped = Transform.from_rotvec(TOP.translation, (np.pi, 0.0, 0.0))
    with pytest.raises(GeometryError, match="into the head"):
        on_scalp(sphere, flipped)
    for offsets in ([[0.0, float("nan")]], [[0.0, 0.0, 0.0]], [0.0, 0.0]):
        with pytest.raises(GeometryError, match="pairs"):
            along_scalp(sphere, TOP, offsets)


def test_poses_between_the_places_lie_on_the_scalp() -> None:
    """On a sphere, where the scalp is known without edges."""
    search = HotspotSearch.begin(HotspotSettings(), sphere, TOP)
    rng = np.random.default_rng(3)
    for x, y in rng.uniform(-0.015, 0.015, (50, 2)):
        pose = search.pose_at(np.array((x, y, 0.98 * RADIUS)), 0.4)
        assert np.linalg.norm(pose.translation) == pytest.approx(RADIUS, abs=1e-5)
        assert pose.rotation[:, 2] @ pose.translation / RADIUS > math.cos(math.radians(0.2))
        (carried,) = along_scalp(sphere, TOP, RADIUS * np.arccos(pose.translation[2] / RADIUS) * _unit(x, y)[None])
        assert heading(carried, pose) == pytest.approx(0.4, abs=0.01)
