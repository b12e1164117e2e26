"""Inverse kinematics of a UR in closed form: all branches, turns, singular postures, limits and poses out of reach."""

from dataclasses import replace

import numpy as np
import pytest

from pcmrs.errors import UnreachableError
from pcmrs.kinematics import _ur as ur
from pcmrs.kinematics._geometry import UrGeometry
from pcmrs.kinematics._posture import cost
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.spatial import Transform
from tests.support.trials import run_counts
from tests.unit.kinematics.reached_poses import assert_reaches


@pytest.fixture(scope="module")
def arm() -> ArmModel:
    return ArmModel(find_arm("ur5"))


def branches(arm: ArmModel, target: Transform, seed: np.ndarray) -> np.ndarray:
    assert isinstance(arm.geometry, UrGeometry)
    return np.array(ur._postures(arm, arm.geometry, target, seed))


@run_counts(1000, nightly=10_000)
def test_every_branch_reaches_and_one_is_the_known_posture(arm: ArmModel, runs: int) -> None:
    counts = set()
    for known, seed in np.random.default_rng(31).uniform(arm.lower, arm.upper, (runs, 2, 6)):
        target = arm.forward(known)
        found = branches(arm, target, seed)
        counts.add(len(found))
        for posture in found:
            np.testing.assert_allclose(arm.forward(posture).matrix, target.matrix, atol=1e-9)
        assert np.abs(np.exp(1j * found) - np.exp(1j * known)).max(axis=1).min() < 1e-6
        apart = np.abs(np.exp(1j * found[:, None]) - np.exp(1j * found)).max(axis=2)
        assert np.all(apart[np.triu_indices(len(found), 1)] > 0.0)
    assert {4, 8} <= counts <= {2, 4, 6, 8}


@run_counts(300, nightly=3000)
def test_no_branch_in_any_turn_costs_less_than_the_answer(arm: ArmModel, runs: int) -> None:
    turns = 2.0 * np.pi * np.array(np.meshgrid(*[(-1, 0, 1)] * 6)).reshape(6, -1).T
    for known, seed in np.random.default_rng(32).uniform(arm.lower, arm.upper, (runs, 2, 6)):
        target = arm.forward(known)
        found = inverse(arm, target, seed)
        assert_reaches(arm, found, target)
        for branch in branches(arm, target, seed):
            wrapped = np.angle(np.exp(1j * branch)) + turns
            allowed = wrapped[np.all((wrapped >= arm.lower) & (wrapped <= arm.upper), axis=1)]
            nearest = allowed[np.argsort(np.linalg.norm(allowed - seed, axis=1))[:4]]
            assert all(cost(arm, found, seed) <= cost(arm, other, seed) + 1e-6 for other in nearest)


def test_the_seed_chooses_among_all_eight_branches(arm: ArmModel) -> None:
    target = arm.forward(np.array((0.4, -1.0, 1.2, -0.9, 1.1, 0.3)))
    answers = [np.angle(np.exp(1j * posture)) for posture in branches(arm, target, np.zeros(6))]
    assert len(answers) == 8
    for posture in answers:
        np.testing.assert_allclose(inverse(arm, target, posture), posture, atol=1e-9)


def test_a_joint_that_turns_twice_stays_in_the_turn_of_the_seed(arm: ArmModel) -> None:
    known = np.array((0.4, -1.0, 1.2, -0.9, 1.1, 0.3))
    for turned in (known, known - 2.0 * np.pi * np.eye(6)[5], known + 2.0 * np.pi * np.eye(6)[3]):
        np.testing.assert_allclose(inverse(arm, arm.forward(known), turned), turned, atol=1e-9)
    near_limit = known + (arm.upper[0] - 0.01 - known[0]) * np.eye(6)[0]
    assert inverse(arm, arm.forward(near_limit), near_limit)[0] == pytest.approx(arm.upper[0] - 0.01, abs=1e-9)


SINGULAR = {
    "stretched": (0, 0, 0, 0, 0, 0),
    "stretched elbow": (0.3, -0.7, 0, 0.4, 1.0, 0.2),
    "folded elbow": (0.3, -0.7, np.pi, 0.4, 1.0, 0.2),
    "straight wrist": (0.3, -0.7, 1.0, 0.4, 0, 0.2),
    "turned wrist": (0.3, -0.7, 1.0, 0.4, np.pi, 0.2),
    "wrist in the far turn": (0.3, -0.7, 1.0, 0.4, -2 * np.pi, 0.2),
    "all beyond the elbow": (1.0, 0.3, 0, -np.pi / 2, 0, 0.7),
    "all beyond the elbow, turned": (1.0, 0.3, 0, -np.pi / 2, np.pi, 0.7),
    "folded at a limit": (-2 * np.pi, 2 * np.pi, -np.pi, 0.1, 0, 2 * np.pi),
}


@pytest.mark.parametrize("q", SINGULAR.values(), ids=SINGULAR)
def test_singular_postures_are_solved(arm: ArmModel, q: tuple[float, ...]) -> None:
    target = arm.forward(np.clip(q, arm.lower, arm.upper))
    for seed in np.random.default_rng(33).uniform(arm.lower, arm.upper, (20, 6)):
        assert_reaches(arm, inverse(arm, target, seed), target)


def test_a_wrist_above_the_shoulder_is_solved(arm: ArmModel) -> None:
    """The point where axes 5 and 6 meet is as near to axis 1 as it can be."""
    assert isinstance(arm.geometry, UrGeometry)
    upper_arm, forearm, hand = (abs(part) for part in (arm.geometry.upper_arm, arm.geometry.forearm, arm.geometry.hand))
    for pitch in (-0.4, 0.0, 0.8):
        q2 = -np.arccos((hand * np.sin(pitch) - forearm * np.cos(1.9)) / upper_arm)
        q = np.array((0.5, q2, -1.9 - q2, pitch + 1.9, 1.0, 0.2))
        assert arm.geometry.singular_angles(q)[0] < 1e-7
        assert_reaches(arm, inverse(arm, arm.forward(q), np.zeros(6)), arm.forward(q))


@run_counts(300, nightly=3000)
def test_postures_at_limits_are_reached_within_them(arm: ArmModel, runs: int) -> None:
    rng = np.random.default_rng(34)
    narrow = replace(arm.facts, joints=tuple(replace(joint, lower=-2.0, upper=1.5) for joint in arm.facts.joints))
    for limited in (arm, ArmModel(narrow)):
        for known, seed in rng.uniform(limited.lower, limited.upper, (runs, 2, 6)):
            at_limit = rng.random(6) < 0.4
            known = np.where(at_limit, np.where(rng.random(6) < 0.5, limited.lower, limited.upper), known)
            target = limited.forward(known)
            assert_reaches(limited, inverse(limited, target, seed), target)


def test_an_arm_on_a_stand_with_another_flange_is_solved(arm: ArmModel) -> None:
    joints = list(arm.facts.joints)
    joints[0] = replace(joints[0], xyz=(0.3, -0.2, 0.7), rpy=(0.4, 1.1, -2.0))
    other = ArmModel(
        replace(arm.facts, joints=tuple(joints), flange_rpy=(0.1, 0.2, 0.3), flange_xyz=(0.01, 0.02, 0.03))
    )
    for known, seed in np.random.default_rng(35).uniform(other.lower, other.upper, (50, 2, 6)):
        target = other.forward(known)
        assert_reaches(other, inverse(other, target, seed), target)
        assert len(branches(other, target, seed)) >= 2


def test_unreachable_poses_are_refused_with_their_distances(arm: ArmModel) -> None:
    home = np.array(arm.facts.home)
    pose = arm.forward(home)
    far = Transform(pose.rotation, pose.translation + np.array((2.0, 0.0, 0.0)))
    with pytest.raises(UnreachableError, match=r"too far.*stretched arm reaches 0\.8173 m.*mm closer") as caught:
        inverse(arm, far, home)
    assert caught.value.fields["limit"] == pytest.approx(0.425 + 0.39225)
    assert 1.0 < caught.value.fields["reach"] < 3.0
    beside = Transform.from_rotvec((0.0, 0.0, 0.5), (np.pi, 0.0, 0.0))
    with pytest.raises(UnreachableError, match=r"too near.*0\.0000 m from the axis of shoulder_pan_joint.*109\.1 mm"):
        inverse(arm, beside, home)


def test_a_pose_inside_the_folded_arm_is_refused(arm: ArmModel) -> None:
    """With a long upper arm, the wrist cannot reach the shoulder."""
    joints = list(arm.facts.joints)
    joints[2] = replace(joints[2], xyz=(0.0, -0.8, -0.1197))
    long = ArmModel(replace(arm.facts, joints=tuple(joints)))
    pose = long.forward(np.array((0.0, 0.0, np.pi, 0.0, np.pi / 2, 0.0)))
    near = Transform(pose.rotation, pose.translation - np.array((0.1, 0.0, 0.0)))
    with pytest.raises(UnreachableError, match=r"too near.*folded arm reaches 0\.4078 m.*mm away") as caught:
        inverse(long, near, np.zeros(6))
    assert caught.value.fields["reach"] < caught.value.fields["limit"]


def test_pose_beyond_a_joint_limit_names_the_joint(arm: ArmModel) -> None:
    joints = list(arm.facts.joints)
    joints[4] = replace(joints[4], lower=-0.5, upper=0.5)
    narrow = ArmModel(replace(arm.facts, joints=tuple(joints)))
    target = arm.forward(np.array((0.4, -1.0, 1.2, -0.9, 1.1, 0.3)))
    with pytest.raises(UnreachableError, match=r"joint limit.*wrist_2_joint at") as caught:
        inverse(narrow, target, np.zeros(6))
    assert caught.value.fields["joint"] == "wrist_2_joint"
