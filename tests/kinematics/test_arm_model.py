from functools import reduce
from xml.etree.ElementTree import fromstring

import numpy as np
import pytest

from pcmrs.errors import GeometryError, UnreachableError
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.mjcf import mjcf
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf import urdf
from pcmrs.spatial import Transform

pytestmark = pytest.mark.parametrize("name", list(ARMS))


def random_postures(arm: ArmModel, count: int) -> np.ndarray:
    return np.random.default_rng(7).uniform(arm.lower, arm.upper, (count, 7))


def chain_product(name: str, q: np.ndarray) -> Transform:
    facts = ARMS[name]
    steps = [
        joint.parent_from_joint @ Transform.from_rotvec((0, 0, 0), (0, 0, angle))
        for joint, angle in zip(facts.joints, q, strict=True)
    ]
    return reduce(Transform.__matmul__, steps) @ Transform(np.eye(3), np.array(facts.flange_xyz))


def test_forward_is_the_product_of_the_chain(name: str) -> None:
    arm = ArmModel(ARMS[name])
    for q in random_postures(arm, 50):
        np.testing.assert_allclose(arm.forward(q).matrix, chain_product(name, q).matrix, atol=1e-14)


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


def test_jacobian_is_the_derivative_of_forward(name: str) -> None:
    arm = ArmModel(ARMS[name])
    h = 1e-6
    for q in random_postures(arm, 10):
        columns = []
        for step in h * np.eye(7):
            after, before = arm.forward(q + step), arm.forward(q - step)
            turn = Transform(after.rotation @ before.rotation.T, np.zeros(3)).rotvec
            columns.append(np.concatenate((after.translation - before.translation, turn)) / (2 * h))
        np.testing.assert_allclose(arm.jacobian(q), np.array(columns).T, atol=1e-8)


def test_a_joint_out_of_its_limits_is_named(name: str) -> None:
    arm = ArmModel(ARMS[name])
    arm.check_limits(arm.upper)
    arm.check_limits(arm.lower)
    with pytest.raises(UnreachableError, match=r"joint_4 at -120\.57 deg") as caught:
        arm.check_limits(arm.lower - 0.01 * np.eye(7)[3])
    assert caught.value.fields["joint"] == "joint_4"


def test_malformed_joints_are_refused(name: str) -> None:
    arm = ArmModel(ARMS[name])
    for bad in (np.zeros(6), np.full(7, np.nan)):
        for method in (arm.forward, arm.jacobian, arm.check_limits):
            with pytest.raises(GeometryError, match="7 finite numbers"):
                method(bad)


def test_mujoco_agrees_with_pinocchio_on_pose_and_gravity(name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    pinocchio = pytest.importorskip("pinocchio")
    arm = ArmModel(ARMS[name])
    model = mujoco.MjModel.from_xml_string(mjcf(ARMS[name], damping=1.5, armature=0.2, frictionloss=0.4))
    data = mujoco.MjData(model)
    oracle = pinocchio.buildModelFromXML(urdf(ARMS[name]))
    assert model.dof_damping[0] == 1.5
    assert model.dof_armature[0] == 0.2
    assert model.dof_frictionloss[0] == 0.4
    np.testing.assert_allclose(model.jnt_range[:, 1], arm.upper)
    np.testing.assert_allclose(model.actuator_ctrlrange[:, 1], [joint.effort for joint in ARMS[name].joints])
    for q in random_postures(arm, 10):
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        flange = arm.forward(q)
        np.testing.assert_allclose(data.site("flange").xpos, flange.translation, atol=1e-12)
        np.testing.assert_allclose(data.site("flange").xmat.reshape(3, 3), flange.rotation, atol=1e-12)
        gravity = pinocchio.computeGeneralizedGravity(oracle, oracle.createData(), q)
        np.testing.assert_allclose(data.qfrc_bias, gravity, atol=1e-10)
        assert data.ncon == 0, "links must not collide with each other"


def test_inertias_are_physical(name: str) -> None:
    for joint in ARMS[name].joints:
        ixx, iyy, izz, ixy, ixz, iyz = joint.inertia
        principal = np.linalg.eigvalsh([(ixx, ixy, ixz), (ixy, iyy, iyz), (ixz, iyz, izz)])
        assert principal[0] > 0.0
        assert principal[0] + principal[1] >= principal[2]


def test_urdf_names_every_joint_once(name: str) -> None:
    joints = [joint.get("name") for joint in fromstring(urdf(ARMS[name])).iter("joint")]
    assert joints == [f"joint_{number}" for number in range(1, 8)] + ["flange_mount"]
