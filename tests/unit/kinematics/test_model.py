"""The model of an arm: forward kinematics, Jacobian, and limits."""

from functools import reduce

import numpy as np
import pytest

from pcmrs.errors import GeometryError, UnreachableError
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.spatial import Transform
from tests.unit.kinematics.arm_models import every_arm, own_arm, random_postures


def chain_product(name: str, q: np.ndarray) -> Transform:
    facts = find_arm(name)
    steps = [
        joint.parent_from_joint @ Transform.from_rotvec((0, 0, 0), (0, 0, angle))
        for joint, angle in zip(facts.joints, q, strict=True)
    ]
    return reduce(Transform.__matmul__, steps) @ facts.joint_from_flange


@every_arm
def test_forward_is_the_product_of_the_chain(name: str) -> None:
    arm = ArmModel(find_arm(name))
    for q in random_postures(arm, 50):
        np.testing.assert_allclose(arm.forward(q).matrix, chain_product(name, q).matrix, atol=1e-14)


@every_arm
def test_jacobian_is_the_derivative_of_forward(name: str) -> None:
    arm = ArmModel(find_arm(name))
    h = 1e-6
    for q in random_postures(arm, 10):
        columns = []
        for step in h * np.eye(arm.joints):
            after, before = arm.forward(q + step), arm.forward(q - step)
            turn = Transform(after.rotation @ before.rotation.T, np.zeros(3)).rotvec
            columns.append(np.concatenate((after.translation - before.translation, turn)) / (2 * h))
        np.testing.assert_allclose(arm.jacobian(q), np.array(columns).T, atol=1e-8)


@every_arm
def test_the_gap_is_what_leads_to_the_pose(name: str) -> None:
    arm = ArmModel(find_arm(name))
    for q, goal in zip(random_postures(arm, 20), random_postures(arm, 20)[::-1], strict=True):
        pose = arm.forward(goal)
        gap, jacobian = arm.pose_error_and_jacobian(pose, q)
        reached = arm.forward(q)
        np.testing.assert_allclose(reached.translation + gap[:3], pose.translation, atol=1e-14)
        turn = Transform.from_rotvec((0, 0, 0), gap[3:]).rotation
        np.testing.assert_allclose(turn @ reached.rotation, pose.rotation, atol=1e-9)
        np.testing.assert_array_equal(jacobian, arm.jacobian(q))


@every_arm
def test_origins_are_those_of_the_chain(name: str) -> None:
    arm = ArmModel(find_arm(name))
    for q in random_postures(arm, 5):
        pose, origins = Transform.identity(), []
        for joint, angle in zip(arm.facts.joints, q, strict=True):
            pose = pose @ joint.parent_from_joint @ Transform.from_rotvec((0, 0, 0), (0, 0, angle))
            origins.append(pose.translation)
        np.testing.assert_allclose(arm.joint_origins(q), origins, atol=1e-14)


@own_arm
def test_a_joint_out_of_its_limits_is_named(name: str) -> None:
    arm = ArmModel(ARMS[name])
    arm.check_limits(arm.upper)
    arm.check_limits(arm.lower)
    with pytest.raises(UnreachableError, match=r"joint_4 at -120\.57 deg") as caught:
        arm.check_limits(arm.lower - 0.01 * np.eye(7)[3])
    assert caught.value.fields["joint"] == "joint_4"


@every_arm
def test_malformed_joints_are_refused(name: str) -> None:
    arm = ArmModel(find_arm(name))
    for bad in (np.zeros(arm.joints - 1), np.full(arm.joints, np.nan)):
        for method in (arm.forward, arm.jacobian, arm.check_limits, arm.joint_origins):
            with pytest.raises(GeometryError, match=f"{arm.joints} finite numbers"):
                method(bad)
