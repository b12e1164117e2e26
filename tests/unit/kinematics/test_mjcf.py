"""Arms in MuJoCo, with Pinocchio as the oracle."""

import numpy as np
import pytest

from pcmrs.kinematics.mjcf import mjcf
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf import urdf
from pcmrs.kinematics.urdf_arms import find_arm
from tests.unit.kinematics.arm_models import every_arm, random_postures


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
