"""Inverse kinematics of arms without a closed form, such as a Panda and a UR with measured dimensions."""

from typing import Any

import numpy as np
import pytest

from pcmrs.errors import GeometryError, UnreachableError
from pcmrs.kinematics import _numeric as numeric
from pcmrs.kinematics._least_squares import damped_least_squares
from pcmrs.kinematics._posture import cost
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.track import track
from pcmrs.spatial import Transform
from tests.support.trials import run_counts
from tests.unit.kinematics.arm_models import calibrated
from tests.unit.kinematics.reached_poses import assert_reaches


@pytest.fixture(params=["panda", "ur5"])
def arm(request: pytest.FixtureRequest) -> ArmModel:
    return calibrated(request.param)


@run_counts(60, nightly=250)
def test_every_reachable_pose_is_reached(arm: ArmModel, runs: int) -> None:
    for known, seed in np.random.default_rng(21).uniform(arm.lower, arm.upper, (runs, 2, arm.joints)):
        target = arm.forward(known)
        assert_reaches(arm, inverse(arm, target, seed), target)


def test_the_same_question_has_the_same_answer(arm: ArmModel) -> None:
    known, seed = np.random.default_rng(22).uniform(arm.lower, arm.upper, (2, arm.joints))
    target = arm.forward(known)
    np.testing.assert_array_equal(inverse(arm, target, seed), inverse(ArmModel(arm.facts), target, seed))


def test_a_comfortable_posture_near_the_seed_is_taken(arm: ArmModel) -> None:
    home = np.array(arm.facts.home)
    assert cost(arm, home, home) == 0.0
    for shift in np.random.default_rng(23).uniform(-0.02, 0.02, (50, 3)):
        target = arm.forward(home) @ Transform.from_rotvec(shift, shift)
        found = inverse(arm, target, home)
        assert_reaches(arm, found, target)
        assert np.linalg.norm(found - home) < 0.6


def test_search_ends_at_a_comfortable_posture_or_a_few_solutions(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each descent takes time, and a plan waits for all of them."""
    arm, descents = calibrated("panda"), 0

    def count(*given: Any) -> Any:
        nonlocal descents
        descents += 1
        return damped_least_squares(*given)

    monkeypatch.setattr(numeric, "damped_least_squares", count)
    home = np.array(arm.facts.home)
    inverse(arm, arm.forward(home), home)
    assert descents == 1
    at_limit = home.copy()
    at_limit[-1] = arm.upper[-1] - 0.01
    inverse(arm, arm.forward(at_limit), at_limit, keep_away=np.array([(*arm.joint_origins(home)[-1], 10.0)]))
    assert 1 + numeric._SOLUTIONS <= descents < numeric._RESTARTS


def test_among_uncomfortable_postures_the_best_found_is_taken() -> None:
    arm = calibrated("panda")
    better = 0
    for known in np.random.default_rng(24).uniform(arm.lower, arm.upper, (30, arm.joints)):
        seed = np.clip(known, arm.lower + 0.05, arm.upper - 0.05)
        seed[-1] = arm.upper[-1] - 0.05
        target = arm.forward(seed)
        found = inverse(arm, target, seed)
        assert cost(arm, found, seed) <= cost(arm, seed, seed) + 1e-6
        better += cost(arm, found, seed) < cost(arm, seed, seed) - 0.01
    assert better > 0


def test_the_margin_is_kept(arm: ArmModel) -> None:
    margin = 0.2
    for q in np.random.default_rng(25).uniform(arm.lower + margin, arm.upper - margin, (20, arm.joints)):
        found = inverse(arm, arm.forward(q), arm.upper, joint_margin=margin)
        assert np.all(found >= arm.lower + margin)
        assert np.all(found <= arm.upper - margin)


def test_a_joint_that_turns_twice_is_not_turned_for_nothing() -> None:
    arm = calibrated("ur5")
    for known, seed in np.random.default_rng(26).uniform(arm.lower, arm.upper, (20, 2, 6)):
        found = inverse(arm, arm.forward(known), seed)
        for turned in (found - 2 * np.pi, found + 2 * np.pi):
            allowed = (turned >= arm.lower) & (turned <= arm.upper)
            assert np.all(np.abs(turned - seed)[allowed] > np.abs(found - seed)[allowed])


def test_forearm_keeps_away_from_a_sphere(arm: ArmModel) -> None:
    home = np.array(arm.facts.home)
    sphere = np.array([(*arm.joint_origins(home)[-3], 0.05)])
    found = inverse(arm, arm.forward(home), home, keep_away=sphere)
    assert_reaches(arm, found, arm.forward(home))
    assert cost(arm, found, home, sphere) <= cost(arm, home, home, sphere)


def test_unreachable_pose_is_refused_with_its_distance(arm: ArmModel) -> None:
    with pytest.raises(UnreachableError, match=f"{arm.facts.name}.*mm and .* deg away") as caught:
        inverse(arm, Transform(np.eye(3), np.array((0.0, 0.0, 2.0))), arm.facts.home)
    assert 0.5 < caught.value.fields["gap"] < 1.5


def test_a_margin_that_leaves_no_range_is_refused(arm: ArmModel) -> None:
    with pytest.raises(UnreachableError, match="no range"):
        inverse(arm, arm.forward(arm.facts.home), arm.facts.home, joint_margin=3.2)


def test_a_malformed_seed_is_refused(arm: ArmModel) -> None:
    for solve in (inverse, track):
        with pytest.raises(GeometryError, match=f"{arm.joints} finite numbers"):
            solve(arm, arm.forward(arm.facts.home), np.zeros(arm.joints + 1))


def test_small_corrections_stay_near_the_seed(arm: ArmModel) -> None:
    home = np.array(arm.facts.home)
    for shift in np.random.default_rng(27).uniform(-0.005, 0.005, (50, 3)):
        target = arm.forward(home) @ Transform.from_rotvec(shift, 2 * shift)
        found = track(arm, target, home)
        assert_reaches(arm, found, target)
        assert np.linalg.norm(found - home) < 0.2
