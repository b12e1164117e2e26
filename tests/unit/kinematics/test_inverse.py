"""Inverse kinematics: the posture of least cost."""

import numpy as np
import pytest

from pcmrs.errors import GeometryError
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.posture import cost, sphere_distances
from pcmrs.kinematics.track import track
from pcmrs.spatial import Transform
from tests.support.trials import run_counts
from tests.unit.kinematics.reached_poses import READY, assert_reaches


@pytest.fixture(params=list(ARMS))
def arm(request: pytest.FixtureRequest) -> ArmModel:
    return ArmModel(ARMS[request.param])


@run_counts(250, nightly=1000)
def test_every_pose_is_reached_at_no_more_than_the_known_cost(arm: ArmModel, runs: int) -> None:
    rng = np.random.default_rng(11)
    for known, seed in rng.uniform(arm.lower, arm.upper, (runs, 2, 7)):
        target = arm.forward(known)
        found = inverse(arm, target, seed)
        assert_reaches(arm, found, target)
        assert cost(arm, found, seed) < cost(arm, known, seed) + 0.01


def test_a_comfortable_seed_is_the_answer_for_its_own_pose(arm: ArmModel) -> None:
    comfortable = 0
    for q in np.random.default_rng(12).uniform(arm.lower, arm.upper, (200, 7)):
        if cost(arm, q, q) == 0.0:
            comfortable += 1
            np.testing.assert_allclose(inverse(arm, arm.forward(q), q), q, atol=1e-9)
    assert comfortable > 20


def test_a_posture_at_a_limit_is_left_for_a_better_one(arm: ArmModel) -> None:
    q = READY.copy()
    q[4] = arm.upper[4] - 0.02
    found = inverse(arm, arm.forward(q), q)
    assert_reaches(arm, found, arm.forward(q))
    assert arm.upper[4] - found[4] > 0.08
    assert np.linalg.norm(found - q) < 1.0


def test_elbow_keeps_away_from_a_sphere(arm: ArmModel) -> None:
    target = arm.forward(READY)
    elbow, wrist = arm.joint_origins(READY)[[3, 5]]
    sphere = (*(0.7 * elbow + 0.3 * wrist), 0.05)
    found = inverse(arm, target, READY, keep_away=[sphere])
    assert_reaches(arm, found, target)
    elbow, wrist = arm.joint_origins(found)[[3, 5]]
    assert sphere_distances(elbow[None], wrist[None], np.array([sphere]))[0, 0] > 0.03
    np.testing.assert_array_equal(
        inverse(arm, target, READY, keep_away=[(5.0, 5.0, 5.0, 0.1)]), inverse(arm, target, READY)
    )


def test_near_poses_have_near_postures(arm: ArmModel) -> None:
    """Along a line, seeded with where the arm is, nothing flips."""
    q = READY
    for step in np.linspace(0.0, 0.15, 31):
        found = inverse(arm, arm.forward(READY) @ Transform.from_rotvec((0, step, -step), (0, 2 * step, 0)), q)
        assert np.abs(found - q).max() < 0.12
        q = found


def test_the_margin_is_kept(arm: ArmModel) -> None:
    margin = 0.2
    rng = np.random.default_rng(13)
    for q in rng.uniform(arm.lower + margin, arm.upper - margin, (50, 7)):
        found = inverse(arm, arm.forward(q), arm.upper, joint_margin=margin)
        assert np.all(found >= arm.lower + margin)
        assert np.all(found <= arm.upper - margin)


def test_a_malformed_seed_is_refused(arm: ArmModel) -> None:
    for solve in (inverse, track):
        with pytest.raises(GeometryError, match="7 finite numbers"):
            solve(arm, arm.forward(READY), np.zeros(6))
