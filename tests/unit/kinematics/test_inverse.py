"""Inverse kinematics in closed form: the posture of least cost."""

import numpy as np
import pytest

from pcmrs.errors import GeometryError
from pcmrs.kinematics._posture import cost, sphere_distances
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.track import track
from pcmrs.kinematics.urdf_arms import KNOWN, find_arm
from pcmrs.spatial import Transform
from tests.support.trials import run_counts
from tests.unit.kinematics.reached_poses import assert_reaches


@pytest.fixture(params=KNOWN)
def arm(request: pytest.FixtureRequest) -> ArmModel:
    return ArmModel(find_arm(request.param))


@pytest.fixture(params=["iiwa14", "iiwa7", "panda"])
def redundant(request: pytest.FixtureRequest) -> ArmModel:
    """An arm of seven joints, which can move while its flange rests."""
    return ArmModel(find_arm(request.param))


def ready(arm: ArmModel) -> np.ndarray:
    return np.array(arm.facts.home)


@run_counts(250, nightly=1000)
def test_every_pose_is_reached_at_no_more_than_the_known_cost(arm: ArmModel, runs: int) -> None:
    rng = np.random.default_rng(11)
    for known, seed in rng.uniform(arm.lower, arm.upper, (runs, 2, arm.joints)):
        target = arm.forward(known)
        found = inverse(arm, target, seed)
        assert_reaches(arm, found, target)
        assert cost(arm, found, seed) < cost(arm, known, seed) + 0.01


def test_a_comfortable_seed_is_the_answer_for_its_own_pose(arm: ArmModel) -> None:
    comfortable = 0
    for q in np.random.default_rng(12).uniform(arm.lower, arm.upper, (200, arm.joints)):
        if cost(arm, q, q) == 0.0:
            comfortable += 1
            np.testing.assert_allclose(inverse(arm, arm.forward(q), q), q, atol=1e-9)
    assert comfortable > 20


def test_a_posture_at_a_limit_is_left_for_a_better_one(redundant: ArmModel) -> None:
    arm = redundant
    q = ready(arm)
    q[4] = arm.upper[4] - 0.02
    found = inverse(arm, arm.forward(q), q)
    assert_reaches(arm, found, arm.forward(q))
    assert arm.upper[4] - found[4] > 0.08
    assert np.linalg.norm(found - q) < 1.0


def test_elbow_keeps_away_from_a_sphere(redundant: ArmModel) -> None:
    arm = redundant
    target = arm.forward(ready(arm))
    elbow, wrist = arm.joint_origins(ready(arm))[[3, 5]]
    sphere = (*(0.7 * elbow + 0.3 * wrist), 0.05)
    found = inverse(arm, target, ready(arm), keep_away=[sphere])
    assert_reaches(arm, found, target)
    elbow, wrist = arm.joint_origins(found)[[3, 5]]
    assert sphere_distances(elbow[None], wrist[None], np.array([sphere]))[0, 0] > 0.03
    np.testing.assert_array_equal(
        inverse(arm, target, ready(arm), keep_away=[(5.0, 5.0, 5.0, 0.1)]), inverse(arm, target, ready(arm))
    )


def test_near_poses_have_near_postures(arm: ArmModel) -> None:
    """Along a line, seeded with where the arm is, nothing flips."""
    q = ready(arm)
    for step in np.linspace(0.0, 0.1, 21):
        found = inverse(arm, arm.forward(ready(arm)) @ Transform.from_rotvec((0, step, step), (0, 2 * step, 0)), q)
        assert np.abs(found - q).max() < 0.12
        q = found


def test_the_margin_is_kept(arm: ArmModel) -> None:
    margin = 0.2
    rng = np.random.default_rng(13)
    for q in rng.uniform(arm.lower + margin, arm.upper - margin, (50, arm.joints)):
        found = inverse(arm, arm.forward(q), arm.upper, joint_margin=margin)
        assert np.all(found >= arm.lower + margin)
        assert np.all(found <= arm.upper - margin)


def test_a_malformed_seed_is_refused(arm: ArmModel) -> None:
    for solve in (inverse, track):
        with pytest.raises(GeometryError, match=f"{arm.joints} finite numbers"):
            solve(arm, arm.forward(ready(arm)), np.zeros(arm.joints + 1))
