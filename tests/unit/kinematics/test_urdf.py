"""Arms as URDF."""

from xml.etree.ElementTree import fromstring

import numpy as np

from pcmrs.kinematics._urdf_reader import read_urdf
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.urdf import urdf
from pcmrs.kinematics.urdf_arms import find_arm
from tests.unit.kinematics.arm_models import every_arm, own_arm


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
