"""Every arm that is known, and variants of them, for tests."""

from dataclasses import replace

import numpy as np
import pytest

from pcmrs.kinematics._geometry import SrsGeometry
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import KNOWN, find_arm

every_arm = pytest.mark.parametrize("name", KNOWN)

own_arm = pytest.mark.parametrize("name", list(ARMS))


def random_postures(arm: ArmModel, count: int) -> np.ndarray:
    return np.random.default_rng(7).uniform(arm.lower, arm.upper, (count, arm.joints))


def calibrated(name: str) -> ArmModel:
    """An arm with measured dimensions, which fit no closed form: every joint is 0.1 mm and 0.1 mrad off."""
    facts = find_arm(name)
    joints = []
    for number, joint in enumerate(facts.joints):
        (x, y, z), (roll, pitch, yaw) = joint.xyz, joint.rpy
        off = 1e-4 * (-1) ** number
        joints.append(replace(joint, xyz=(x + off, y, z - off), rpy=(roll + off, pitch - off, yaw)))
    return ArmModel(replace(facts, joints=tuple(joints)))


def heights(arm: ArmModel) -> np.ndarray:
    """Heights of the joints and of the flange of an S-R-S arm that stands upright, m, (8,)."""
    assert isinstance(arm.geometry, SrsGeometry)
    return arm.geometry.heights
