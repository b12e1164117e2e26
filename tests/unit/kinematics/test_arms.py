"""Facts of the arms, against their data sheets and the laws of physics."""

import numpy as np

from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from tests.unit.kinematics.arm_models import every_arm, heights, own_arm


@own_arm
def test_lengths_and_limits_are_those_of_the_data_sheet(name: str) -> None:
    arm = ArmModel(ARMS[name])
    d_bs, d_se, d_ew, d_wf = {"iiwa14": (0.36, 0.42, 0.40, 0.126), "iiwa7": (0.34, 0.40, 0.40, 0.126)}[name]
    upright = arm.forward(np.zeros(7))
    np.testing.assert_allclose(upright.matrix[:3, 3], (0, 0, d_bs + d_se + d_ew + d_wf), atol=1e-15)
    np.testing.assert_allclose(upright.rotation, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(np.diff(heights(arm)[[1, 3, 5, 7]]), (d_se, d_ew, d_wf))
    np.testing.assert_allclose(np.degrees(arm.upper), (170, 120, 170, 120, 170, 120, 175))
    np.testing.assert_array_equal(arm.lower, -arm.upper)
    speeds = {"iiwa14": (85, 85, 100, 75, 130, 135, 135), "iiwa7": (98, 98, 100, 130, 140, 180, 180)}[name]
    np.testing.assert_allclose(np.degrees(arm.velocity), speeds)


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
