"""Errors of recorded placements against homogeneous matrices worked out anew."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pcmrs.analysis.placements import placement_error, summarize
from pcmrs.spatial import Transform

number = st.floats(-2.0, 2.0)
vector = st.tuples(number, number, number)
poses = st.builds(Transform.from_rotvec, vector, vector)


@given(poses, poses, st.floats(0.0, 0.1))
def test_error_is_between_tool_pose_and_planned_standoff_pose(
    planned: Transform, measured: Transform, standoff: float
) -> None:
    error = placement_error(planned, measured, standoff)
    # The standoff is along the measured tool's own axis: what remains is the plan, seen in the tool's frame.
    back = np.eye(4)
    back[2, 3] = -standoff
    stood_for = measured.matrix @ back
    assert error.distance == pytest.approx(float(np.linalg.norm(stood_for[:3, 3] - planned.translation)), abs=1e-12)
    assert measured.rotation @ error.vector == pytest.approx(stood_for[:3, 3] - planned.translation, abs=1e-12)
    relative = Rotation.from_matrix(planned.rotation).inv() * Rotation.from_matrix(measured.rotation)
    assert error.angle == pytest.approx(float(relative.magnitude()), abs=1e-7)


@given(poses, poses, poses)
def test_the_error_does_not_depend_on_the_image_frame(
    planned: Transform, measured: Transform, moved: Transform
) -> None:
    here, there = placement_error(planned, measured, 0.01), placement_error(moved @ planned, moved @ measured, 0.01)
    assert here.vector == pytest.approx(there.vector, abs=1e-12)
    assert here.angle == pytest.approx(there.angle, abs=1e-7)


def test_a_tool_at_its_standoff_has_no_error() -> None:
    planned = Transform.from_rotvec((0.1, 0.2, 0.3), (1.0, -0.4, 0.2))
    error = placement_error(planned, planned @ Transform.from_rotvec((0.0, 0.0, 0.01), np.zeros(3)), 0.01)
    assert error.distance < 1e-15
    assert error.angle < 1e-15


def test_the_standard_deviation_is_that_of_a_sample() -> None:
    summary = summarize([1.0, 2.0, 4.0])
    assert summary.mean == pytest.approx(7 / 3)
    assert summary.max == 4.0
    assert summary.sd == pytest.approx(np.sqrt(7 / 3))
    assert summarize([3.0]).sd is None
