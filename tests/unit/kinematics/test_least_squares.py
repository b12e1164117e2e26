"""Damped least squares towards a pose within joint limits."""

import numpy as np
import pytest

from pcmrs.kinematics._least_squares import TOLERANCE, damped_least_squares
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.spatial import Transform


@pytest.fixture(params=["iiwa14", "panda", "ur5"])
def arm(request: pytest.FixtureRequest) -> ArmModel:
    return ArmModel(find_arm(request.param))


def test_a_near_pose_is_reached_near_the_start(arm: ArmModel) -> None:
    home = np.array(arm.facts.home)
    for shift in np.random.default_rng(61).uniform(-0.01, 0.01, (30, 3)):
        target = arm.forward(home) @ Transform.from_rotvec(shift, shift)
        q, error = damped_least_squares(arm, target, home, arm.lower, arm.upper)
        assert np.linalg.norm(error) <= TOLERANCE
        np.testing.assert_allclose(arm.forward(q).matrix, target.matrix, atol=1e-9)
        assert np.linalg.norm(q - home) < 0.3


def test_the_limits_given_are_kept_and_the_error_is_that_left(arm: ArmModel) -> None:
    home = np.array(arm.facts.home)
    lower, upper = home - 0.01, home + 0.01
    target = arm.forward(home) @ Transform.from_rotvec((0.1, 0.1, 0.0), (0.0, 0.1, 0.0))
    q, error = damped_least_squares(arm, target, home + 1.0, lower, upper)
    assert np.all((q >= lower) & (q <= upper))
    assert np.linalg.norm(error) > 0.05
    np.testing.assert_allclose(error[:3], target.translation - arm.forward(q).translation, atol=1e-12)
