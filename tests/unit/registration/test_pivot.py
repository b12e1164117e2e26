"""Pivot calibration against known tips: exact, under noise, with bad poses, and where the motion fixes nothing."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from pcmrs.errors import DegenerateMotionError, RefusalError
from pcmrs.registration.pivot import MIN_POSES, calibrate_pivot
from pcmrs.spatial import Floats, Transform
from tests.support.trials import run_counts
from tests.unit.registration.pivot_poses import NOISE, PIVOT, TIP, poses_about, shifted

coordinate = st.floats(-0.5, 0.5)
point = st.tuples(coordinate, coordinate, coordinate)


@given(tip=point, pivot=point, seed=st.integers(0, 2**16), count=st.integers(MIN_POSES, 30))
def test_exact_poses_give_the_tip_back(tip: Floats, pivot: Floats, seed: int, count: int) -> None:
    poses = poses_about(np.random.default_rng(seed), count, tip=np.array(tip), pivot=np.array(pivot))
    found = calibrate_pivot(poses)
    assert found.tip_in_pointer == pytest.approx(tip, abs=1e-9)
    assert found.pivot_in_tracker == pytest.approx(pivot, abs=1e-9)
    assert found.bad == ()
    assert found.rms < 1e-9


def test_the_tip_does_not_depend_on_where_the_tracker_is() -> None:
    poses = poses_about(np.random.default_rng(1), 40, NOISE)
    elsewhere = Transform.from_rotvec((3.0, -2.0, 1.0), (0.4, 1.0, -0.3))
    here, there = calibrate_pivot(poses), calibrate_pivot([elsewhere @ pose for pose in poses])
    assert there.tip_in_pointer == pytest.approx(here.tip_in_pointer, abs=1e-10)
    assert there.pivot_in_tracker == pytest.approx(elsewhere @ here.pivot_in_tracker, abs=1e-10)


@run_counts(120, nightly=400)
def test_the_covariance_is_the_scatter_of_many_calibrations(runs: int) -> None:
    rng = np.random.default_rng(2)
    rotations = [pose.rotation for pose in poses_about(rng, 60)]
    found = []
    for _ in range(runs):
        noisy = [Transform(r, PIVOT - r @ TIP + rng.normal(0.0, NOISE, 3)) for r in rotations]
        found.append(calibrate_pivot(noisy))
    tips = np.array([each.tip_in_pointer for each in found])
    assert np.abs(tips.mean(axis=0) - TIP).max() < 4 * tips.std() / np.sqrt(len(tips))
    predicted = np.mean([each.covariance for each in found], axis=0)
    assert np.cov(tips.T) == pytest.approx(predicted, abs=0.2 * np.trace(predicted) / 3)
    assert np.mean([each.rms for each in found]) == pytest.approx(NOISE * np.sqrt(3 * (1 - 6 / 180)), rel=0.02)
    alarms = sum(bool(each.bad) for each in found)
    assert alarms <= 0.0375 * runs, (
        "no pose is bad, and at most 1 % of the sets should lose one, by either of two tests"
    )


@pytest.mark.parametrize(("count", "bad"), [(12, [3]), (20, [0, 7, 19]), (60, [3, 4, 5, 6, 40, 41, 42, 43, 58, 59])])
def test_bad_poses_are_named_and_left_out(count: int, bad: list[int]) -> None:
    poses = shifted(poses_about(np.random.default_rng(3), count, NOISE), bad, 0.003)
    found = calibrate_pivot(poses)
    assert found.bad == tuple(bad)
    assert found.distances.shape == (count,)
    assert found.distances[bad].min() > 0.002
    assert np.linalg.norm(found.tip_in_pointer - TIP) < 2e-4


def test_indistinguishable_bad_poses_give_no_calibration() -> None:
    rng = np.random.default_rng(4)
    poses = poses_about(rng, 30, NOISE)
    bad = list(range(0, 30, 3))
    with pytest.raises(RefusalError) as refused:
        calibrate_pivot(
            [
                Transform(pose.rotation, pose.translation + rng.normal(0.0, 0.05, 3)) if index in bad else pose
                for index, pose in enumerate(poses)
            ]
        )
    assert refused.value.refusal_code == "too_many_bad_poses"
    assert set(refused.value.fields["bad"]) <= set(bad)


def test_too_few_poses_are_refused() -> None:
    with pytest.raises(DegenerateMotionError, match=f"at least {MIN_POSES}"):
        calibrate_pivot(poses_about(np.random.default_rng(5), MIN_POSES - 1))


@given(st.tuples(coordinate, coordinate, coordinate).filter(lambda axis: np.linalg.norm(axis) > 0.1))
def test_turning_about_one_axis_is_refused_and_the_axis_named(axis: tuple[float, float, float]) -> None:
    unit = np.array(axis) / np.linalg.norm(axis)
    rotations = [Rotation.from_rotvec(unit * angle).as_matrix() for angle in np.linspace(-1.0, 1.0, 30)]
    with pytest.raises(DegenerateMotionError, match="turn about the axis") as refused:
        calibrate_pivot([Transform(rotation, PIVOT - rotation @ TIP) for rotation in rotations])
    fields = refused.value.fields
    assert abs(np.dot(fields["axis"], unit)) == pytest.approx(1.0, abs=1e-9)
    assert fields["singular_values"][2] < 1e-9 < fields["limit"] < fields["singular_values"][0]


def test_a_pointer_that_hardly_turns_is_refused() -> None:
    with pytest.raises(DegenerateMotionError, match="hardly turn"):
        calibrate_pivot(poses_about(np.random.default_rng(6), 50, NOISE, tilt=2.0))


def test_where_one_pose_alone_shows_the_tip_nothing_breaks() -> None:
    rng = np.random.default_rng(7)
    rotations = [Rotation.from_rotvec((0.0, 0.0, angle)).as_matrix() for angle in np.linspace(-1.0, 1.0, 30)]
    rotations.append(Rotation.from_rotvec((1.5, 0.0, 0.0)).as_matrix())
    poses = [Transform(turn, PIVOT - turn @ TIP + rng.normal(0.0, NOISE, 3)) for turn in rotations]
    assert calibrate_pivot(poses).tip_in_pointer == pytest.approx(TIP, abs=1e-3)
    with pytest.raises(DegenerateMotionError):  # what fixed the tip was the bad pose
        calibrate_pivot(shifted_sideways(poses, 30))


def shifted_sideways(poses: list[Transform], bad: int) -> list[Transform]:
    """One pose away by a hand's breadth, in every direction."""
    away = np.array([0.1, 0.1, 0.1])
    return [
        Transform(pose.rotation, pose.translation + away) if index == bad else pose for index, pose in enumerate(poses)
    ]
