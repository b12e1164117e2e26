"""Inverse kinematics by small steps from the present posture."""

import numpy as np
import pytest

from pcmrs.errors import UnreachableError
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.track import track
from pcmrs.spatial import Transform
from tests.unit.kinematics.reached_poses import READY, assert_reaches


@pytest.fixture(params=list(ARMS))
def arm(request: pytest.FixtureRequest) -> ArmModel:
    return ArmModel(ARMS[request.param])


def test_small_corrections_stay_near_the_seed(arm: ArmModel) -> None:
    rng = np.random.default_rng(14)
    for _ in range(100):
        seed = READY + rng.uniform(-0.3, 0.3, 7)
        shift, turn = rng.uniform(-0.005, 0.005, 3), rng.uniform(-0.01, 0.01, 3)
        target = arm.forward(seed) @ Transform.from_rotvec(shift, turn)
        found = track(arm, target, seed)
        assert_reaches(arm, found, target)
        assert np.linalg.norm(found - seed) < 0.2


def test_a_joint_at_its_limit_leaves_the_work_to_the_others(arm: ArmModel) -> None:
    seed = READY.copy()
    seed[6] = arm.upper[6]
    pushed = seed + 0.02 * np.eye(7)[6]
    target = arm.forward(pushed)
    found = track(arm, target, seed)
    assert_reaches(arm, found, target)


def test_tracking_out_of_the_workspace_is_refused(arm: ArmModel) -> None:
    target = Transform(np.eye(3), np.array((0.0, 0.0, arm.geometry.heights[7] + 0.05)))
    with pytest.raises(UnreachableError, match="cannot follow") as caught:
        track(arm, target, READY)
    assert caught.value.fields["gap"] > 0.04
