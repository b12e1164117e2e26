"""Choice among the branches of a closed form."""

import numpy as np
import pytest

from pcmrs.errors import UnreachableError
from pcmrs.kinematics._branches import FORBIDDEN, ROUNDING, Branches, flipped, limit_error, settled
from pcmrs.kinematics._posture import DETOUR, LIMIT_COMFORT, comfort_penalty
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.spatial import Transform
from tests.unit.kinematics.reached_poses import READY, assert_reaches

ROWS = ((0, 1, 2, 3, 4, 5, 6), (7, 1, 2, 3, 4, 5, 6), (7, 1, 2, 3, 4, 5, 8))


@pytest.fixture(scope="module")
def arm() -> ArmModel:
    return ArmModel(find_arm("iiwa14"))


def test_scores_are_the_costs_of_the_postures(arm: ArmModel) -> None:
    branches, rng = Branches(ROWS), np.random.default_rng(51)
    np.testing.assert_array_equal(branches.joints, (0, 1, 2, 3, 4, 5, 6, 0, 6))
    values = rng.uniform(0.99 * arm.lower, 0.99 * arm.upper, (20, 7)).T[list(branches.joints)]
    values[7:] = 0.5 * values[[0, 6]]
    shared = rng.uniform(0.0, 1.0, 20)
    scores = branches.scores(arm, values, READY, 0.0, shared)
    for branch, rows in enumerate(ROWS):
        for column in range(20):
            posture = branches.posture(values, branch, column)
            np.testing.assert_array_equal(posture, values[list(rows), column])
            slack = np.minimum(posture - arm.lower, arm.upper - posture)
            comfort = DETOUR * comfort_penalty(slack, LIMIT_COMFORT).sum()
            expected = np.linalg.norm(posture - READY) + comfort + shared[column]
            assert scores[branch, column] == pytest.approx(expected)


def test_a_posture_beyond_a_limit_ranks_by_its_excess(arm: ArmModel) -> None:
    branches = Branches([range(7)])
    over = np.array((0.0, 0.5 * ROUNDING, 1e-6, 0.1, 0.2))
    values = np.tile(READY[:, None], 5)
    values[2] = arm.upper[2] - 0.3 + over
    scores = branches.scores(arm, values, READY, 0.3, np.zeros(5))[0]
    assert np.all(scores[:2] < FORBIDDEN)
    np.testing.assert_allclose(scores[2:] - FORBIDDEN, over[2:], atol=2 * ROUNDING)


def test_a_flipped_shoulder_turns_the_arm_to_the_same_pose(arm: ArmModel) -> None:
    for q in np.random.default_rng(52).uniform(-np.pi, np.pi, (20, 7)):
        for joints in ([0, 1, 2], [4, 5, 6]):
            other = q.copy()
            other[joints] = flipped(q[joints])
            assert np.all(np.abs(other) <= np.pi)
            np.testing.assert_allclose(arm.forward(other).matrix, arm.forward(q).matrix, atol=1e-12)


def test_the_only_posture_at_several_limits_is_settled_on(arm: ArmModel) -> None:
    known = READY.copy()
    known[[0, 4, 6]] = arm.lower[0], arm.upper[4], arm.lower[6]
    target = arm.forward(known)
    found = settled(arm, target, known + np.array((-1e-3, 0, 0, 0, 1e-3, 0, -1e-3)), 0.0)
    assert_reaches(arm, found, target)


def test_the_joint_farthest_beyond_its_limit_is_named(arm: ArmModel) -> None:
    posture = READY + 3.0 * np.eye(7)[2] + 2.5 * np.eye(7)[4]
    with pytest.raises(UnreachableError, match=r"joint_3 at 183\.35 deg, limits -170 to 170 deg with a margin of 5\.7"):
        raise limit_error(arm, posture, 0.1)
    with pytest.raises(UnreachableError, match="joint limit") as caught:
        settled(arm, Transform.from_rotvec((0.0, 0.0, 2.0), (0.0, 0.0, 0.0)), posture, 0.1)
    assert caught.value.fields["joint"] == "joint_3"
    assert caught.value.fields["upper"] == pytest.approx(arm.upper[2] - 0.1)
