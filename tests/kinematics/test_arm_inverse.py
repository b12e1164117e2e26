import numpy as np
import pytest

from pcmrs.errors import GeometryError, UnreachableError
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.track import track
from pcmrs.spatial import Transform, distance, rotation_angle

READY = np.array((0.1, 0.5, 0.2, -1.2, 0.3, 0.9, 0.1))


@pytest.fixture(params=list(ARMS))
def arm(request: pytest.FixtureRequest) -> ArmModel:
    return ArmModel(ARMS[request.param])


def assert_reaches(arm: ArmModel, q: np.ndarray, target: Transform) -> None:
    arm.check_limits(q)
    assert distance(arm.forward(q), target) < 1e-9
    assert rotation_angle(arm.forward(q), target) < 1e-9


def test_every_reachable_pose_is_reached_at_least_as_near_as_the_known_posture(arm: ArmModel) -> None:
    rng = np.random.default_rng(11)
    for known, seed in rng.uniform(arm.lower, arm.upper, (1000, 2, 7)):
        target = arm.forward(known)
        found = inverse(arm, target, seed)
        assert_reaches(arm, found, target)
        assert np.linalg.norm(found - seed) < np.linalg.norm(known - seed) + 1e-3


def test_the_seed_itself_is_the_answer_for_its_own_pose(arm: ArmModel) -> None:
    for q in np.random.default_rng(12).uniform(arm.lower, arm.upper, (100, 7)):
        np.testing.assert_allclose(inverse(arm, arm.forward(q), q), q, atol=1e-9)


@pytest.mark.parametrize(
    "q",
    [
        (0, 0, 0, -np.pi / 2, 0, np.pi / 2, 0),
        (0.5, 0, -0.2, 1.0, 0.3, 0.4, 0.1),
        (0.3, 0.4, 0.2, 1.0, 0.3, 0, 0.4),
        (0.3, 0.4, 0.2, 0, 0.3, 0.5, 0),
        (0, 0, 0, 0, 0, 0, 0),
    ],
    ids=["candle bent", "upper arm upright", "hand straight", "arm stretched", "candle"],
)
def test_singular_postures_are_solved(arm: ArmModel, q: tuple[float, ...]) -> None:
    target = arm.forward(q)
    assert_reaches(arm, inverse(arm, target, np.full(7, 0.2)), target)


def test_the_margin_is_kept(arm: ArmModel) -> None:
    margin = 0.2
    rng = np.random.default_rng(13)
    for q in rng.uniform(arm.lower + margin, arm.upper - margin, (50, 7)):
        found = inverse(arm, arm.forward(q), arm.upper, joint_margin=margin)
        assert np.all(found >= arm.lower + margin)
        assert np.all(found <= arm.upper - margin)


def test_what_is_out_of_reach_says_how_far(arm: ArmModel) -> None:
    far = Transform(np.eye(3), np.array((0.0, 0.0, arm.heights[7] + 0.05)))
    with pytest.raises(UnreachableError, match=r"too far.*50\.0 mm closer"):
        inverse(arm, far, READY)
    near = Transform(np.eye(3), np.array((0.1, 0.0, arm.heights[1] + arm.heights[7] - arm.heights[5])))
    with pytest.raises(UnreachableError, match=r"too near.*joint_4"):
        inverse(arm, near, READY)


def test_what_only_the_limits_forbid_names_the_joint(arm: ArmModel) -> None:
    stretched_by_limits = arm.forward((0, 0, 0, -1.5, 0, arm.upper[5] + 0.3, 0))
    with pytest.raises(UnreachableError, match="joint limit") as caught:
        inverse(arm, stretched_by_limits, READY, joint_margin=0.5)
    assert caught.value.fields["joint"].startswith("joint_")


def test_a_malformed_seed_is_refused(arm: ArmModel) -> None:
    for solve in (inverse, track):
        with pytest.raises(GeometryError, match="7 finite numbers"):
            solve(arm, arm.forward(READY), np.zeros(6))


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
    target = Transform(np.eye(3), np.array((0.0, 0.0, arm.heights[7] + 0.05)))
    with pytest.raises(UnreachableError, match="cannot follow") as caught:
        track(arm, target, READY)
    assert caught.value.fields["gap"] > 0.04
