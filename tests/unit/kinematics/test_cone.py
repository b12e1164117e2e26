""""""

from __future__ import annotations

from math import radians, tan

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.kinematics.cone import ApproachCone
from pcmrs.spatial import Transform

CONE = ApproachCone(half_angle=radians(30.0), height=0.06, radius=0.02, depth=0.01)

TARGET = Transform.from_rotvec((0.4, -0.1, 0.2), (0.5, -1.0, 2.0))

angles = st.floats(-np.pi, np.pi)


def excess(*point: float) -> float:
    """Of a point given in the frame of the target."""
    return float(CONE.excess(TARGET, TARGET @ np.array(point))[0])


@given(st.floats(0.0, 1.0), angles, st.floats(0.0, 0.05))
def test_inside_the_cone_everything_is_allowed(part: float, angle: float, height: float) -> None:
    beside = 0.999 * part * (0.02 + height * tan(radians(30.0)))
    assert excess(beside * np.cos(angle), beside * np.sin(angle), height) == 0.0


@given(st.floats(0.001, 0.03), angles, st.floats(0.0, 0.02))
def test_beside_the_cone_the_excess_is_the_way_back_to_it(beyond: float, angle: float, height: float) -> None:
    beside = 0.02 + height * tan(radians(30.0)) + beyond
    point = (beside * np.cos(angle), beside * np.sin(angle), height)
    if np.linalg.norm(point) < 0.0599:
        assert np.isclose(excess(*point), beyond, atol=1e-9)


def test_below_the_target_the_tool_may_go_so_deep_only() -> None:
    assert excess(0.0, 0.0, -0.0099) == 0.0
    assert np.isclose(excess(0.01, 0.0, -0.013), 0.003)
    assert np.isclose(excess(0.025, 0.0, -0.002), 0.005), "the cone does not narrow below the target"


def test_far_from_the_target_everything_is_allowed() -> None:
    assert excess(0.0601, 0.0, 0.0) == 0.0
    assert excess(0.0, 0.0, -0.0601) == 0.0
    assert excess(0.0599, 0.0, 0.0) > 0.0


def test_many_points_at_once() -> None:
    points = TARGET @ np.array(((0.0, 0.0, 0.0), (0.03, 0.0, 0.0), (0.5, 0.0, 0.0)))
    np.testing.assert_allclose(CONE.excess(TARGET, points), (0.0, 0.01, 0.0), atol=1e-9)
