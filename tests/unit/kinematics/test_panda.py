"""Inverse kinematics of a Panda in closed form: both elbows, singular postures, limits, and the scan of joint 7."""

from dataclasses import replace

import numpy as np
import pytest

from pcmrs.errors import UnreachableError
from pcmrs.kinematics import _panda as panda
from pcmrs.kinematics._geometry import PandaGeometry
from pcmrs.kinematics._posture import cost
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.spatial import Transform
from tests.support.trials import run_counts
from tests.unit.kinematics.reached_poses import assert_reaches

STRETCHED = -0.4669


@pytest.fixture(scope="module")
def arm() -> ArmModel:
    return ArmModel(find_arm("panda"))


@run_counts(1000, nightly=20_000)
def test_every_pose_within_reach_is_reached(arm: ArmModel, runs: int) -> None:
    for known, seed in np.random.default_rng(41).uniform(arm.lower, arm.upper, (runs, 2, 7)):
        target = arm.forward(known)
        assert_reaches(arm, inverse(arm, target, seed), target)


@run_counts(100, nightly=1000)
def test_all_candidates_at_joint_7_reach_and_one_is_known(arm: ArmModel, runs: int) -> None:
    assert isinstance(arm.geometry, PandaGeometry)
    counts = set()
    for known, seed in np.random.default_rng(42).uniform(arm.lower, arm.upper, (runs, 2, 7)):
        target = arm.forward(known)
        candidates = panda._Target(arm, arm.geometry, target, seed, 0.0, None)
        values, missing = candidates._values(known[6:], within=False)
        found = np.concatenate([values[list(rows)].T[missing == 0.0] for rows in panda._BRANCHES.rows])
        counts.add(len(found))
        for posture in found:
            np.testing.assert_allclose(arm.forward(posture).matrix, target.matrix, atol=1e-9)
        assert np.abs(np.exp(1j * found) - np.exp(1j * known)).max(axis=1).min() < 1e-6
    assert {4, 8} <= counts


def test_elbows_on_both_sides_of_the_stretched_arm_are_found(arm: ArmModel) -> None:
    for q4 in (STRETCHED - 0.2, STRETCHED + 0.2):
        q = np.array((0.2, 0.5, -0.3, q4, 0.4, 1.5, 0.3))
        np.testing.assert_allclose(inverse(arm, arm.forward(q), q), q, atol=1e-9)


@run_counts(20, nightly=60)
def test_thirty_times_finer_scan_is_hardly_better(arm: ArmModel, monkeypatch: pytest.MonkeyPatch, runs: int) -> None:
    rng = np.random.default_rng(43)
    spheres = np.array(((0.5, 0.1, 0.3, 0.15), (-0.4, 0.2, 0.8, 0.1)))
    problems = [(arm.forward(known), seed) for known, seed in rng.uniform(arm.lower, arm.upper, (runs, 2, 7))]
    costs = [cost(arm, inverse(arm, target, seed, keep_away=spheres), seed, spheres) for target, seed in problems]
    monkeypatch.setattr(panda, "_STEPS", 30 * panda._STEPS)
    best = [cost(arm, inverse(arm, target, seed, keep_away=spheres), seed, spheres) for target, seed in problems]
    excess = np.subtract(costs, best)
    assert excess.min() > -1e-3
    assert np.quantile(excess, 0.8) < 1e-3  # the others lie in ways between the limits narrower than the scan


SINGULAR = {
    "straight shoulder": (0.3, 0, 0.4, -1.5, 0.3, 1.5, 0.4),
    "straight arm": (0.3, 0.4, 0.2, STRETCHED, 0.3, 1.5, 0.4),
    "straight arm in line with the hand": (0.3, 0.4, 0.2, STRETCHED, 0, 1.5, 0.4),
    "parallel wrist axes": (0.3, 0.4, 0.2, -1.5, 0.3, 0, 0.4),
    "antiparallel wrist axes": (0.3, 0.4, 0.2, -1.5, 0.3, np.pi, 0.4),
    "shoulder in the plane of the wrist": (0.3, 0.4, 0.2, -1.5, np.pi / 2, 1.0, 0.4),
    "all but upright": (0, 0, 0, -0.0698, 0, 0, 0),
}


@pytest.mark.parametrize("q", SINGULAR.values(), ids=SINGULAR)
def test_singular_postures_are_solved(arm: ArmModel, q: tuple[float, ...]) -> None:
    target = arm.forward(q)
    for seed in np.random.default_rng(44).uniform(arm.lower, arm.upper, (10, 7)):
        assert_reaches(arm, inverse(arm, target, seed), target)


@run_counts(200, nightly=2000)
def test_postures_at_several_limits_are_reached_within_them(arm: ArmModel, runs: int) -> None:
    """But for one in a thousand, which is the only posture for its pose, and near a singular one."""
    rng, refused = np.random.default_rng(45), 0
    for known, seed in rng.uniform(arm.lower, arm.upper, (runs, 2, 7)):
        at_limit = rng.random(7) < 0.4
        known = np.where(at_limit, np.where(rng.random(7) < 0.5, arm.lower, arm.upper), known)
        try:
            assert_reaches(arm, inverse(arm, arm.forward(known), seed), arm.forward(known))
        except UnreachableError:
            refused += 1
    assert refused <= runs / 1000


def test_an_interval_that_the_scan_misses_is_found(arm: ArmModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """All joints but one are within a degree of a limit, so that joint 7 has little way."""
    monkeypatch.setattr(panda, "_STEPS", 1)
    rng = np.random.default_rng(46)
    for seed in rng.uniform(arm.lower, arm.upper, (30, 7)):
        known = np.where(rng.random(7) < 0.5, arm.lower + 0.01, arm.upper - 0.01)
        assert_reaches(arm, inverse(arm, arm.forward(known), seed), arm.forward(known))


def test_an_arm_on_a_stand_with_another_flange_is_solved(arm: ArmModel) -> None:
    joints = list(arm.facts.joints)
    joints[0] = replace(joints[0], xyz=(0.3, -0.2, 0.7), rpy=(0.4, 1.1, -2.0))
    other = ArmModel(
        replace(arm.facts, joints=tuple(joints), flange_rpy=(0.1, 0.2, 0.3), flange_xyz=(0.01, 0.02, 0.03))
    )
    spheres = np.array(((0.5, 0.1, 0.3, 0.15), (-0.4, 0.2, 0.8, 0.1)))
    costs = []
    for known, seed in np.random.default_rng(47).uniform(other.lower, other.upper, (50, 2, 7)):
        target = other.forward(known)
        found = inverse(other, target, seed, keep_away=spheres)
        assert_reaches(other, found, target)
        costs.append(cost(other, found, seed, spheres) - cost(other, known, seed, spheres))
    assert max(costs) < 0.01


def test_unreachable_poses_are_refused_with_their_distances(arm: ArmModel) -> None:
    home = np.array(arm.facts.home)
    pose = arm.forward(home)
    far = Transform(pose.rotation, pose.translation + np.array((2.0, 0.0, 0.0)))
    with pytest.raises(UnreachableError, match=r"too far.*stretched arm reaches 0\.7194 m.*mm closer") as caught:
        inverse(arm, far, home)
    assert 1.0 < caught.value.fields["reach"] < 3.0
    assert caught.value.fields["limit"] == pytest.approx(np.hypot(0.316, 0.0825) + np.hypot(0.384, 0.0825))


def test_a_pose_inside_the_folded_arm_is_refused(arm: ArmModel) -> None:
    """With a long forearm, the wrist cannot reach the shoulder."""
    joints = list(arm.facts.joints)
    joints[4] = replace(joints[4], xyz=(-0.0825, 0.6, 0.0))
    long = ArmModel(replace(arm.facts, joints=tuple(joints)))
    with pytest.raises(UnreachableError, match=r"too near.*folded arm reaches 0\.2791 m.*mm away") as caught:
        inverse(long, Transform.from_rotvec((0.0, 0.0, 0.44), (0.0, 0.0, 0.0)), arm.facts.home)
    assert caught.value.fields["reach"] < caught.value.fields["limit"]


def test_pose_beyond_a_joint_limit_names_the_joint(arm: ArmModel) -> None:
    joints = list(arm.facts.joints)
    joints[5] = replace(joints[5], lower=0.0, upper=0.5)
    narrow = ArmModel(replace(arm.facts, joints=tuple(joints)))
    with pytest.raises(UnreachableError, match=r"joint limit.*panda_joint6 at") as caught:
        inverse(narrow, arm.forward((0.0, 0.6, 0.0, -1.5, 0.0, 2.0, 0.0)), narrow.facts.home)
    assert caught.value.fields["joint"] == "panda_joint6"
