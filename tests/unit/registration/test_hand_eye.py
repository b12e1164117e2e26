"""Hand-eye and robot-world calibration against known X and Y."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pcmrs.errors import DegenerateMotionError, GeometryError, RefusalError
from pcmrs.registration.hand_eye import MIN_POSES, HandEyeCalibration, calibrate_hand_eye, closed_form
from pcmrs.spatial import Floats, Transform, distance, rotation_angle
from tests.support.trials import run_counts

X = Transform.from_rotvec((0.01, 0.02, 0.15), (2.0, 1.0, 0.5))
Y = Transform.from_rotvec((1.5, 0.3, 0.9), (0.4, -2.0, 1.0))
DOWN = Rotation.from_rotvec((3.0, 0.1, 0.0))

number = st.floats(-2.0, 2.0)
triple = st.tuples(number, number, number)
Poses = tuple[list[Transform], list[Transform]]


class Noise:
    """Of the arm and the tracker, per axis: rad and m."""

    ARM = (2e-4, 5e-4)
    TRACKER = (3.5e-4, 1e-4)


def noisy(rng: np.random.Generator, pose: Transform, noise: tuple[float, float]) -> Transform:
    turn = Rotation.from_rotvec(rng.normal(0.0, noise[0], 3)).as_matrix()
    return Transform(pose.rotation @ turn, pose.translation + rng.normal(0.0, noise[1], 3))


def postures(rng: np.random.Generator, count: int, turn: float = 40.0) -> list[Transform]:
    """Poses of a flange over a body."""
    turns = Rotation.from_euler("xyz", rng.uniform(-turn, turn, (count, 3)), degrees=True)
    places = np.array([0.5, 0.0, 0.5]) + rng.uniform(-0.15, 0.15, (count, 3))
    return [Transform((one * DOWN).as_matrix(), place) for one, place in zip(turns, places, strict=True)]


def seen(flange: list[Transform], x: Transform = X, y: Transform = Y) -> list[Transform]:
    return [y.inverse() @ pose @ x for pose in flange]


def measured(rng: np.random.Generator, count: int) -> Poses:
    flange = postures(rng, count)
    tool = [noisy(rng, pose, Noise.TRACKER) for pose in seen(flange)]
    return [noisy(rng, pose, Noise.ARM) for pose in flange], tool


def spoiled(tool: list[Transform], bad: list[int], by: Transform) -> list[Transform]:
    return [pose @ by if index in bad else pose for index, pose in enumerate(tool)]


def errors(found: HandEyeCalibration) -> Floats:
    """Of X in the convention of the covariance, (6,)."""
    turn = Rotation.from_matrix(X.rotation.T @ found.flange_from_tool_marker.rotation).as_rotvec()
    return np.concatenate((turn, found.flange_from_tool_marker.translation - X.translation))


@given(triple, triple, triple, triple, st.integers(0, 2**16), st.integers(MIN_POSES, 20))
def test_exact_poses_give_both_transforms_back(
    x_at: Floats, x_turn: Floats, y_at: Floats, y_turn: Floats, seed: int, count: int
) -> None:
    x, y = Transform.from_rotvec(x_at, x_turn), Transform.from_rotvec(y_at, y_turn)
    flange = postures(np.random.default_rng(seed), count)
    if np.linalg.svd(np.array([pose.rotation - flange[0].rotation for pose in flange]).reshape(-1, 3))[1][2] < 0.5:
        return  # drawn nearly degenerate
    found = calibrate_hand_eye(flange, seen(flange, x, y))
    for calibrated, true in ((found.flange_from_tool_marker, x), (found.base_from_tracker, y)):
        assert distance(calibrated, true) < 1e-8
        assert rotation_angle(calibrated, true) < 1e-8
    assert found.bad == ()
    assert found.rms < 1e-8


@pytest.mark.nightly
def test_the_covariance_is_the_scatter_of_many_calibrations() -> None:
    rng = np.random.default_rng(2)
    flange = postures(rng, 20)
    tool = seen(flange)
    found = [
        calibrate_hand_eye(
            [noisy(rng, pose, Noise.ARM) for pose in flange], [noisy(rng, pose, Noise.TRACKER) for pose in tool]
        )
        for _ in range(150)
    ]
    scatter = np.std([errors(each) for each in found], axis=0)
    predicted = np.sqrt(np.mean([np.diag(each.covariance) for each in found], axis=0))
    assert scatter == pytest.approx(predicted, rel=0.25)
    assert sum(bool(each.bad) for each in found) <= 7, "no pose is bad"


@run_counts(20, nightly=60)
def test_weights_beat_the_closed_form_if_rotations_are_noisy(runs: int) -> None:
    rng = np.random.default_rng(3)
    refined, closed = [], []
    for _ in range(runs):
        flange = postures(rng, 20)
        tool = [noisy(rng, pose, (3.5e-4, 3e-5)) for pose in seen(flange)]
        found, (shah, _) = calibrate_hand_eye(flange, tool), closed_form(flange, tool)
        refined.append(rotation_angle(found.flange_from_tool_marker, X))
        closed.append(rotation_angle(shah, X))
    assert np.mean(np.square(refined)) < 0.7 * np.mean(np.square(closed))


@pytest.mark.parametrize(
    "by",
    [Transform.from_rotvec((0.01, 0.0, 0.0), (0.0, 0.0, 0.0)), Transform.from_rotvec((0.0,) * 3, (0.02, 0.0, 0.0))],
)
@pytest.mark.parametrize(("count", "bad"), [(8, [4]), (12, [0]), (20, [3, 11, 12])])
def test_bad_poses_are_named_and_left_out(count: int, bad: list[int], by: Transform) -> None:
    flange, tool = measured(np.random.default_rng(4), count)
    found = calibrate_hand_eye(flange, spoiled(tool, bad, by))
    assert found.bad == tuple(bad)
    assert distance(found.flange_from_tool_marker, X) < 2e-3
    assert rotation_angle(found.flange_from_tool_marker, X) < 1e-3
    assert found.distances.shape == found.angles.shape == (count,)


def test_tool_poses_in_the_wrong_order_show_in_the_residual() -> None:
    flange, tool = measured(np.random.default_rng(5), 20)
    found = calibrate_hand_eye(flange, tool[1:] + tool[:1])
    assert found.rms > 0.05
    assert np.degrees(found.rms_angle) > 5.0


def test_indistinguishable_bad_poses_give_no_calibration() -> None:
    rng = np.random.default_rng(5)
    flange, tool = measured(rng, 20)
    for bad in (1, 4, 8, 9, 15, 17):
        tool[bad] = noisy(rng, tool[bad], (0.1, 0.05))
    with pytest.raises(RefusalError) as refused:
        calibrate_hand_eye(flange, tool)
    assert refused.value.refusal_code == "too_many_bad_poses"


def test_too_few_poses_are_refused() -> None:
    flange = postures(np.random.default_rng(6), MIN_POSES - 1)
    with pytest.raises(DegenerateMotionError, match=f"at least {MIN_POSES}"):
        calibrate_hand_eye(flange, seen(flange))


def test_poses_come_in_pairs() -> None:
    flange = postures(np.random.default_rng(6), 8)
    with pytest.raises(GeometryError, match="8 poses of the flange but 7"):
        calibrate_hand_eye(flange, seen(flange)[1:])


def test_parallel_axes_are_refused_and_the_axis_named() -> None:
    rng = np.random.default_rng(7)
    turns = [Rotation.from_rotvec((0.0, 0.0, angle)).as_matrix() for angle in np.linspace(-1.0, 1.0, 12)]
    flange = [Transform(turn, rng.uniform(-0.5, 0.5, 3)) for turn in turns]
    with pytest.raises(DegenerateMotionError, match="in the frame of the flange") as refused:
        calibrate_hand_eye(flange, seen(flange))
    assert abs(refused.value.fields["axis"][2]) == pytest.approx(1.0)
