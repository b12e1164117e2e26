from functools import reduce
from xml.etree.ElementTree import fromstring

import numpy as np
import pytest

from pcmrs.errors import GeometryError, UnreachableError
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.mjcf import mjcf
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf import urdf
from pcmrs.kinematics.urdf_arms import KNOWN, find_arm
from pcmrs.kinematics.urdf_reader import read_urdf
from pcmrs.spatial import Transform

every_arm = pytest.mark.parametrize("name", KNOWN)
own_arm = pytest.mark.parametrize("name", list(ARMS))


def random_postures(arm: ArmModel, count: int) -> np.ndarray:
    return np.random.default_rng(7).uniform(arm.lower, arm.upper, (count, arm.joints))


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


@own_arm
def test_lengths_and_limits_are_those_of_the_data_sheet(name: str) -> None:
    arm = ArmModel(ARMS[name])
    d_bs, d_se, d_ew, d_wf = {"iiwa14": (0.36, 0.42, 0.40, 0.126), "iiwa7": (0.34, 0.40, 0.40, 0.126)}[name]
    upright = arm.forward(np.zeros(7))
    np.testing.assert_allclose(upright.matrix[:3, 3], (0, 0, d_bs + d_se + d_ew + d_wf), atol=1e-15)
    np.testing.assert_allclose(upright.rotation, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(np.diff(arm.heights[[1, 3, 5, 7]]), (d_se, d_ew, d_wf))
    np.testing.assert_allclose(np.degrees(arm.upper), (170, 120, 170, 120, 170, 120, 175))
    np.testing.assert_array_equal(arm.lower, -arm.upper)
    speeds = {"iiwa14": (85, 85, 100, 75, 130, 135, 135), "iiwa7": (98, 98, 100, 130, 140, 180, 180)}[name]
    np.testing.assert_allclose(np.degrees(arm.velocity), speeds)


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


@every_arm
def test_only_the_iiwa_is_spherical(name: str) -> None:
    assert ArmModel(find_arm(name)).spherical == (name in ARMS)


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


@every_arm
def test_mujoco_and_pinocchio_agree_on_pose_and_inverse_dynamics(name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    pinocchio = pytest.importorskip("pinocchio")
    arm = ArmModel(find_arm(name))
    model = mujoco.MjModel.from_xml_string(mjcf(arm.facts, damping=0.0, armature=0.2, frictionloss=0.0))
    data = mujoco.MjData(model)
    oracle = pinocchio.buildModelFromXML(urdf(arm.facts))
    oracle.armature = np.full(arm.joints, 0.2)
    rng = np.random.default_rng(8)
    for q in random_postures(arm, 50):
        velocity, acceleration = rng.uniform(-arm.velocity, arm.velocity), rng.uniform(-10.0, 10.0, arm.joints)
        data.qpos[:], data.qvel[:], data.qacc[:] = q, velocity, acceleration
        mujoco.mj_inverse(model, data)
        torque = pinocchio.rnea(oracle, oracle.createData(), q, velocity, acceleration)
        np.testing.assert_allclose(data.qfrc_inverse, torque, atol=1e-9)
        flange = arm.forward(q)
        np.testing.assert_allclose(data.site("flange").xpos, flange.translation, atol=1e-9)
        np.testing.assert_allclose(data.site("flange").xmat.reshape(3, 3), flange.rotation, atol=1e-9)
        assert data.ncon == 0, "links must not collide with each other"


@every_arm
def test_the_plant_has_the_friction_and_the_limits_it_is_given(name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    facts = find_arm(name)
    model = mujoco.MjModel.from_xml_string(mjcf(facts, damping=1.5, armature=0.2, frictionloss=0.4))
    for array, value in ((model.dof_damping, 1.5), (model.dof_armature, 0.2), (model.dof_frictionloss, 0.4)):
        np.testing.assert_array_equal(array, np.full(len(facts.joints), value))
    np.testing.assert_allclose(model.jnt_range, [(joint.lower, joint.upper) for joint in facts.joints])
    np.testing.assert_allclose(model.actuator_ctrlrange[:, 1], [joint.effort for joint in facts.joints])


@every_arm
def test_inertias_are_physical(name: str) -> None:
    for joint in find_arm(name).joints:
        ixx, iyy, izz, ixy, ixz, iyz = joint.inertia
        principal = np.linalg.eigvalsh([(ixx, ixy, ixz), (ixy, iyy, iyz), (ixz, iyz, izz)])
        assert principal[0] > 0.0
        assert principal[0] + principal[1] >= principal[2]


@every_arm
def test_the_home_posture_has_every_joint_well_within_its_limits(name: str) -> None:
    arm = ArmModel(find_arm(name))
    assert np.minimum(np.subtract(arm.facts.home, arm.lower), np.subtract(arm.upper, arm.facts.home)).min() > 0.2
    assert len(arm.facts.stiffness) == arm.joints


@own_arm
def test_urdf_names_every_joint_once(name: str) -> None:
    joints = [joint.get("name") for joint in fromstring(urdf(ARMS[name])).iter("joint")]
    assert joints == [f"joint_{number}" for number in range(1, 8)] + ["flange_mount"]


@every_arm
def test_an_arm_written_as_urdf_is_read_back(name: str) -> None:
    facts = find_arm(name)
    back = read_urdf(urdf(facts), name, home=facts.home, stiffness=facts.stiffness)
    assert (back.name, back.home, back.stiffness) == (name, facts.home, facts.stiffness)
    np.testing.assert_allclose(back.joint_from_flange.matrix, facts.joint_from_flange.matrix, atol=1e-15)
    for joint, other in zip(facts.joints, back.joints, strict=True):
        assert (joint.name, joint.lower, joint.upper) == (other.name, other.lower, other.upper)
        assert (joint.velocity, joint.effort, joint.mass) == (other.velocity, other.effort, other.mass)
        np.testing.assert_allclose(joint.parent_from_joint.matrix, other.parent_from_joint.matrix, atol=1e-15)
        np.testing.assert_allclose(joint.com, other.com, atol=1e-15)
        np.testing.assert_allclose(joint.inertia, other.inertia, atol=1e-15)
