"""Every arm that is known, for tests."""

import numpy as np
import pytest

from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import KNOWN

every_arm = pytest.mark.parametrize("name", KNOWN)

own_arm = pytest.mark.parametrize("name", list(ARMS))


def random_postures(arm: ArmModel, count: int) -> np.ndarray:
    return np.random.default_rng(7).uniform(arm.lower, arm.upper, (count, arm.joints))
