"""Inverse kinematics by small steps from the present posture."""

import numpy as np
import pytest

from pcmrs.errors import UnreachableError
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.track import UnreachableReason, track
from pcmrs.kinematics.urdf_arms import KNOWN, find_arm
from pcmrs.spatial import Transform
from tests.support.trials import run_counts
from tests.unit.kinematics.arm_models import calibrated
from tests.unit.kinematics.reached_poses import READY, assert_reaches


@pytest.fixture(params=KNOWN)
def arm(request: pytest.FixtureRequest) -> ArmModel:
    return ArmModel(find_arm(request.param))


def reason(arm: ArmModel, target: Transform, seed: np.ndarray) -> UnreachableReason:
    with pytest.raises(
        UnreachableError, match=r"cannot follow to the pose: it stops .* mm and .* deg before it"
    ) as caught:
        track(arm, target, seed)
    why: UnreachableReason = caught.value.fields["reason"]
    return why


def test_small_corrections_stay_near_the_seed(arm: ArmModel) -> None:
    rng = np.random.default_rng(14)
    for _ in range(50):
        seed = np.array(arm.facts.home) + rng.uniform(-0.1, 0.1, arm.joints)
        shift, turn = rng.uniform(-0.005, 0.005, 3), rng.uniform(-0.01, 0.01, 3)
        target = arm.forward(seed) @ Transform.from_rotvec(shift, turn)
        found = track(arm, target, seed)
        assert_reaches(arm, found, target)
        assert np.linalg.norm(found - seed) < 0.2


def test_a_joint_at_its_limit_leaves_the_work_to_the_others() -> None:
    arm = ArmModel(find_arm("iiwa14"))
    seed = READY.copy()
    seed[6] = arm.upper[6]
    pushed = seed + 0.02 * np.eye(7)[6]
    target = arm.forward(pushed)
    found = track(arm, target, seed)
    assert_reaches(arm, found, target)


@run_counts(300, nightly=10_000)
def test_every_small_step_succeeds_or_has_a_reason(arm: ArmModel, runs: int) -> None:
    """Also beside the limits and in singular postures; the reason is never that nothing is known."""
    rng, failed = np.random.default_rng(15), set()
    for seed in rng.uniform(arm.lower, arm.upper, (runs, arm.joints)):
        seed = np.where(rng.random(arm.joints) < 0.3, np.clip(0.0, arm.lower, arm.upper), seed)
        step = Transform.from_rotvec(rng.uniform(-0.002, 0.002, 3), rng.uniform(-0.003, 0.003, 3))
        target = arm.forward(seed) @ step
        try:
            assert_reaches(arm, track(arm, target, seed), target)
        except UnreachableError as error:
            failed.add(error.fields["reason"])
    assert failed <= {"workspace", "joint_limit", "other_posture"}


def test_tracking_out_of_the_workspace_is_refused(arm: ArmModel) -> None:
    home = np.array(arm.facts.home)
    pose = arm.forward(home)
    far = Transform(pose.rotation, pose.translation + np.array((2.0, 0.0, 0.0)))
    assert reason(arm, far, home) == "workspace"
    with pytest.raises(UnreachableError, match=r"too far.*mm closer") as caught:
        track(arm, far, home)
    assert caught.value.fields["gap"] > 0.5
    assert caught.value.fields["reach"] > caught.value.fields["limit"]
    arm.check_limits(caught.value.fields["positions"])


def test_a_limit_that_no_posture_keeps_is_named() -> None:
    arm = ArmModel(find_arm("iiwa14"))
    seed = np.array((0.0, 0.0, 0.0, -1.5, 0.0, arm.upper[5], 0.0))
    target = arm.forward(seed + 0.3 * np.eye(7)[5])
    assert reason(arm, target, seed) == "joint_limit"
    with pytest.raises(UnreachableError, match="joint limit") as caught:
        track(arm, target, seed)
    assert caught.value.fields["joint"].startswith("joint_")


def test_a_step_that_needs_another_posture_says_which_joint() -> None:
    """The elbow is stretched: only with the shoulder on the other side does the wrist get there."""
    arm = ArmModel(find_arm("ur5"))
    seed = np.array((0.3, -0.7, 0.02, 0.9, 1.0, 0.2))
    pose = arm.forward(seed)
    outwards = pose.translation - np.array((0.0, 0.0, 0.089159))
    target = Transform(pose.rotation, pose.translation + 0.002 * outwards / np.linalg.norm(outwards))
    assert reason(arm, target, seed) == "other_posture"
    with pytest.raises(
        UnreachableError, match=r"Only another posture reaches it, with \w+ turned by \d+ deg"
    ) as caught:
        track(arm, target, seed)
    assert caught.value.fields["move"] > 0.3


def test_an_arm_without_a_closed_form_cannot_say_why() -> None:
    arm = calibrated("ur5")
    home = np.array(arm.facts.home)
    assert reason(arm, Transform(np.eye(3), np.array((0.0, 0.0, 2.0))), home) == "unknown"
