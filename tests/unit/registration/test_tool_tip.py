"""Contact point of a tool against a known one, and the predicted error against the scatter of many calibrations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from trimesh.creation import icosphere

from pcmrs.errors import DegenerateMotionError, DegeneratePointsError, RefusalError
from pcmrs.registration.tool_tip import TouchNoise, tip_from_mesh, tip_from_pivots, tip_from_points
from pcmrs.spatial import Floats, Transform, distance, rotation_angle

TIP = Transform.from_rotvec((-0.06, 0.03, -0.06), (0.8, 0.4, 0.8))
"""``tool_marker_from_tool_tip``, which is to be found."""
POINTS = np.array([(0.0, 0.0, 0.0), (0.05, 0.0, 0.01), (-0.05, 0.01, 0.01), (0.0, 0.06, 0.02), (0.02, -0.05, 0.03)])
NOISE = TouchNoise(point=0.3e-3, surface=0.2e-3)
EXACT = TouchNoise(point=1e-6, surface=1e-6)


def touched(rng: np.random.Generator, points: Floats = POINTS, sigma: float = NOISE.point) -> Floats:
    found: Floats = TIP @ points + rng.normal(0.0, sigma, points.shape)
    return found


def pivoted(rng: np.random.Generator, in_marker: Floats, count: int = 30, tilt: float = 0.6) -> list[Transform]:
    """Poses of the marker body while a point of the tool rests on one point."""
    turns = Rotation.from_euler("xyz", rng.uniform(-tilt, tilt, (count, 3))).as_matrix()
    return [Transform(turn, np.array((0.1, 0.2, 1.8)) - turn @ in_marker + rng.normal(0.0, 5e-5, 3)) for turn in turns]


@pytest.mark.parametrize("count", [3, 5])
def test_exact_points_give_the_contact_point_back(count: int) -> None:
    found = tip_from_points(POINTS[:count], TIP @ POINTS[:count], EXACT)
    assert distance(found.tool_marker_from_tool_tip, TIP) < 1e-9
    assert rotation_angle(found.tool_marker_from_tool_tip, TIP) < 1e-7
    assert found.rms < 1e-9


def test_predicted_error_is_the_scatter_of_many_calibrations() -> None:
    rng, shifts, turns, predicted = np.random.default_rng(1), [], [], []
    for _ in range(300):
        found = tip_from_points(POINTS, touched(rng), EXACT)
        shifts.append(distance(found.tool_marker_from_tool_tip, TIP))
        turns.append(rotation_angle(found.tool_marker_from_tool_tip, TIP))
        predicted.append((found.error, found.angle_error))
    error, angle_error = np.sqrt(np.mean(np.square(predicted), axis=0))
    assert error == pytest.approx(np.sqrt(np.mean(np.square(shifts))), rel=0.15)
    assert angle_error == pytest.approx(np.sqrt(np.mean(np.square(turns))), rel=0.15)


def test_few_points_that_fit_well_by_chance_do_not_predict_more() -> None:
    """Three exact touches leave no residual, but the noise of a touch is known."""
    found = tip_from_points(POINTS[1:4], TIP @ POINTS[1:4], NOISE)
    assert found.error > NOISE.point


def test_points_on_a_line_do_not_give_axes() -> None:
    line = np.outer(np.arange(4), (0.01, 0.02, 0.0))
    with pytest.raises(DegeneratePointsError):
        tip_from_points(line, TIP @ line, NOISE)


def ellipsoid() -> tuple[Floats, Floats]:
    mesh = icosphere(subdivisions=4)
    return np.asarray(mesh.vertices) * (0.06, 0.04, 0.02) + (0.0, 0.0, 0.02), np.asarray(mesh.faces)


def test_points_on_the_mesh_lower_the_error() -> None:
    rng, (vertices, faces) = np.random.default_rng(2), ellipsoid()
    known = vertices[[0, 40, 200, 900]]
    on_surface = vertices[faces].mean(axis=1)[rng.choice(len(faces), 80, replace=False)]
    at_known, at_surface = touched(rng, known, 1e-3), touched(rng, on_surface, 0.1e-3)
    noise = TouchNoise(1e-3, 0.1e-3)
    coarse = tip_from_points(known, at_known, noise)
    refined = tip_from_mesh(known, at_known, vertices, faces, at_surface, noise)
    assert refined.error < 0.5 * coarse.error
    assert distance(refined.tool_marker_from_tool_tip, TIP) < 3.0 * refined.error
    assert rotation_angle(refined.tool_marker_from_tool_tip, TIP) < 3.0 * refined.angle_error
    assert len(refined.distances) == len(known)


def test_mesh_of_another_tool_is_refused() -> None:
    rng, (vertices, faces) = np.random.default_rng(3), ellipsoid()
    known = vertices[[0, 40, 200, 900]]
    on_surface = touched(rng, vertices[faces].mean(axis=1)[::60])
    with pytest.raises(RefusalError):
        tip_from_mesh(known, touched(rng, known), 1.5 * vertices, faces, on_surface, NOISE)


def test_pivots_give_the_tip_and_the_axis_of_a_guide() -> None:
    rng = np.random.default_rng(4)
    end = TIP @ np.array((0.0, 0.0, 0.12))
    found = tip_from_pivots(pivoted(rng, TIP.translation), pivoted(rng, end))
    pose = found.tool_marker_from_tool_tip
    assert distance(pose, TIP) < 0.1e-3
    assert pose.rotation[:, 2] @ TIP.rotation[:, 2] > np.cos(np.radians(0.1))
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
    assert found.error == pytest.approx(5e-5 * np.sqrt(3.0), rel=0.5)
    assert 0.0 < found.angle_error < np.radians(0.2)
    assert len(found.distances) == 60


def test_bad_poses_of_both_pivots_are_counted_through() -> None:
    rng = np.random.default_rng(5)
    end = TIP @ np.array((0.0, 0.0, 0.12))
    at_tip, at_end = pivoted(rng, TIP.translation), pivoted(rng, end)
    lift = Transform.from_rotvec((0.0, 0.0, 0.004), (0.0, 0.0, 0.0))
    at_tip[3], at_end[5] = lift @ at_tip[3], lift @ at_end[5]
    found = tip_from_pivots(at_tip, at_end)
    assert found.bad == (3, 35)
    assert found.rms < 0.2e-3


def test_ends_of_an_axis_must_be_apart() -> None:
    rng = np.random.default_rng(6)
    with pytest.raises(RefusalError, match="at least 20 mm") as refused:
        tip_from_pivots(pivoted(rng, TIP.translation), pivoted(rng, TIP @ np.array((0.0, 0.0, 0.01))))
    assert refused.value.refusal_code == "axis_too_short"
    with pytest.raises(DegenerateMotionError):
        tip_from_pivots(pivoted(rng, TIP.translation, tilt=0.01), pivoted(rng, TIP.translation))
