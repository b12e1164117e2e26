"""The cost of a posture."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.kinematics._posture import (
    DETOUR,
    LIMIT_COMFORT,
    SINGULAR_COMFORT,
    comfort_penalty,
    cost,
    sphere_array,
    sphere_distances,
)
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from tests.unit.kinematics.reached_poses import READY


def test_distances_of_links_are_those_of_their_points() -> None:
    rng = np.random.default_rng(17)
    start, end, spheres = rng.uniform(-1, 1, (20, 3)), rng.uniform(-1, 1, (20, 3)), rng.uniform(0, 1, (4, 4))
    points = start[:, None] + np.linspace(0.0, 1.0, 2001)[None, :, None] * (end - start)[:, None]
    expected = np.linalg.norm(points[:, :, None] - spheres[:, :3], axis=-1).min(axis=1) - spheres[:, 3]
    np.testing.assert_allclose(sphere_distances(start, end, spheres), expected, atol=1e-5)
    np.testing.assert_allclose(
        sphere_distances(start, start, spheres),
        np.linalg.norm(start[:, None] - spheres[:, :3], axis=-1) - spheres[:, 3],
    )


@pytest.mark.parametrize("name", ["iiwa14", "ur5"])
def test_a_comfortable_posture_costs_its_distance_from_the_seed(name: str) -> None:
    arm = ArmModel(find_arm(name))
    home = np.array(arm.facts.home)
    for seed in np.random.default_rng(18).uniform(arm.lower, arm.upper, (20, arm.joints)):
        assert cost(arm, home, seed) == pytest.approx(np.linalg.norm(home - seed))
    assert cost(arm, home, home, sphere_array([(9.0, 0.0, 0.0, 0.1)])) == 0.0


@given(st.floats(-0.5, 1.0), st.floats(0.01, 0.5))
def test_the_penalty_grows_smoothly_from_comfort_to_one_at_zero(distance: float, comfort: float) -> None:
    penalty = comfort_penalty(np.array((distance, 0.0, comfort, 0.5 * comfort)), comfort)
    assert penalty.tolist()[1:] == [1.0, 0.0, 0.25]
    assert (penalty[0] == 0.0) == (distance >= comfort)
    assert penalty[0] <= 1.0 or distance < 0.0


@pytest.mark.parametrize("joint", range(7))
def test_a_joint_at_its_limit_costs_a_detour(joint: int) -> None:
    arm = ArmModel(find_arm("iiwa14"))
    for bound, inwards in ((arm.lower, 1.0), (arm.upper, -1.0)):
        costs = []
        for share in (0.0, 0.5, 1.0):
            q = READY.copy()
            q[joint] = bound[joint] + inwards * share * LIMIT_COMFORT
            costs.append(cost(arm, q, q) - cost(arm, READY, READY))
        np.testing.assert_allclose(costs, (DETOUR, 0.25 * DETOUR, 0.0), atol=1e-12)


@pytest.mark.parametrize("joint", [1, 3, 5])
def test_a_straight_shoulder_elbow_or_wrist_costs_a_detour(joint: int) -> None:
    arm = ArmModel(find_arm("iiwa14"))
    q = READY.copy()
    q[joint] = 0.0
    assert cost(arm, q, q) - cost(arm, READY, READY) == pytest.approx(DETOUR)
    q[joint] = np.copysign(SINGULAR_COMFORT, READY[joint])
    assert cost(arm, q, q) == pytest.approx(cost(arm, READY, READY))
