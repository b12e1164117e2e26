"""Geometries with a closed form: recognized in a model, with its dimensions."""

from dataclasses import replace

import numpy as np
import pytest

from pcmrs.kinematics._geometry import PandaGeometry, SrsGeometry, UrGeometry
from pcmrs.kinematics.arms import ArmFacts, Triple
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from tests.unit.kinematics.arm_models import calibrated, every_arm, random_postures

KINDS = {"iiwa14": SrsGeometry, "iiwa7": SrsGeometry, "panda": PandaGeometry, "ur5": UrGeometry}


def changed(facts: ArmFacts, number: int, *, xyz: Triple | None = None, rpy: Triple | None = None) -> ArmFacts:
    joints = list(facts.joints)
    joint = joints[number]
    joints[number] = replace(joint, xyz=xyz or joint.xyz, rpy=rpy or joint.rpy)
    return replace(facts, joints=tuple(joints))


def larger(xyz: Triple) -> Triple:
    x, y, z = xyz
    return 1.3 * x, 1.3 * y, 1.3 * z


@every_arm
def test_every_known_arm_has_its_geometry(name: str) -> None:
    assert isinstance(ArmModel(find_arm(name)).geometry, KINDS[name])


def test_dimensions_of_the_ur5_are_those_of_its_table() -> None:
    """Universal Robots, DH Parameters for calculations of kinematics and dynamics: UR5."""
    geometry = ArmModel(find_arm("ur5")).geometry
    assert isinstance(geometry, UrGeometry)
    lengths = [abs(geometry.upper_arm), abs(geometry.forearm), geometry.offset, abs(geometry.hand)]
    np.testing.assert_allclose(lengths, (0.425, 0.39225, 0.10915, 0.09465), atol=1e-9)
    assert geometry.base_from_shoulder.translation[2] == pytest.approx(0.089159)
    np.testing.assert_allclose(geometry.last_from_flange.translation, (0.0, 0.0823, 0.0), atol=1e-9)


def test_dimensions_of_the_panda_are_those_of_its_table() -> None:
    """Franka Robotics, Robot and interface specifications: Denavit-Hartenberg parameters."""
    geometry = ArmModel(find_arm("panda")).geometry
    assert isinstance(geometry, PandaGeometry)
    lengths = (geometry.upper_arm, geometry.forearm, geometry.elbow, geometry.hand)
    np.testing.assert_allclose(lengths, (0.316, 0.384, 0.0825, 0.088), atol=1e-9)
    assert geometry.base_from_shoulder.translation[2] == pytest.approx(0.333)
    np.testing.assert_allclose(geometry.last_from_flange.translation, (0.088, 0.0, -0.107), atol=1e-9)


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_an_arm_on_a_tilted_stand_keeps_its_geometry(name: str) -> None:
    facts = find_arm(name)
    tilted = ArmModel(changed(facts, 0, xyz=(0.3, -0.2, 0.7), rpy=(0.4, 1.1, -2.0)))
    assert isinstance(tilted.geometry, KINDS[name])
    turned = ArmModel(replace(facts, flange_rpy=(0.1, 0.2, 0.3), flange_xyz=(0.01, 0.02, 0.03)))
    assert isinstance(turned.geometry, KINDS[name])


@every_arm
def test_a_model_that_does_not_fit_has_no_geometry(name: str) -> None:
    """A microradian at one joint is enough."""
    assert calibrated(name).geometry is None
    facts = find_arm(name)
    shorter = replace(facts, joints=facts.joints[1:], home=facts.home[1:], stiffness=facts.stiffness[1:])
    assert ArmModel(shorter).geometry is None
    for number in range(1, len(facts.joints)):
        roll, pitch, yaw = facts.joints[number].rpy
        assert ArmModel(changed(facts, number, rpy=(roll + 1e-6, pitch + 1e-6, yaw))).geometry is None


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_axes_that_no_longer_meet_have_no_geometry(name: str) -> None:
    facts = find_arm(name)
    for number in (1, 5):
        x, y, z = facts.joints[number].xyz
        shifted = [changed(facts, number, xyz=xyz) for xyz in ((x + 1e-6, y, z), (x, y + 1e-6, z), (x, y, z + 1e-6))]
        assert None in [ArmModel(other).geometry for other in shifted]


@every_arm
def test_lengths_along_the_axes_are_free(name: str) -> None:
    """Another size of the same arm is solved with its own dimensions."""
    facts = find_arm(name)
    joints = tuple(replace(joint, xyz=larger(joint.xyz)) for joint in facts.joints)
    grown = replace(facts, joints=joints, flange_xyz=larger(facts.flange_xyz))
    assert isinstance(ArmModel(grown).geometry, KINDS[name])


def test_jacobian_of_the_ur_is_singular_with_its_angles() -> None:
    """Its determinant is the product of shoulder, elbow and wrist; each of them alone makes it zero."""
    arm = ArmModel(find_arm("ur5"))
    assert isinstance(arm.geometry, UrGeometry)
    ratios = []
    for q in random_postures(arm, 50):
        shoulder, elbow, wrist = arm.geometry.singular_angles(q)
        product = np.tan(shoulder) * np.sin(elbow) * np.sin(wrist)
        ratios.append(abs(np.linalg.det(arm.jacobian(q))) / product)
    np.testing.assert_allclose(ratios, ratios[0], rtol=1e-6)


def test_the_stretched_panda_reaches_farthest() -> None:
    arm = ArmModel(find_arm("panda"))
    assert isinstance(arm.geometry, PandaGeometry)

    def reach(q4: float) -> float:
        origins = arm.joint_origins(np.array((0.1, 0.2, 0.3, q4, 0.0, 1.0, 0.0)))
        return float(np.linalg.norm(origins[5] - origins[1]))

    stretched = arm.geometry.stretched
    assert reach(stretched) > max(reach(stretched - 1e-3), reach(stretched + 1e-3))
    angles = arm.geometry.singular_angles(np.array((0.1, 0.2, 0.3, stretched + 0.1, 0.0, 3.0, 0.0)))
    np.testing.assert_allclose(angles, (0.2, 0.1, np.pi - 3.0), atol=1e-12)
