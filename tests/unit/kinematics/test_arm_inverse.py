import numpy as np
import pytest

from pcmrs.errors import GeometryError, UnreachableError
from pcmrs.kinematics import srs
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.posture import cost, sphere_distances
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


def test_every_pose_is_reached_at_no_more_than_the_known_cost(arm: ArmModel) -> None:
    rng = np.random.default_rng(11)
    for known, seed in rng.uniform(arm.lower, arm.upper, (1000, 2, 7)):
        target = arm.forward(known)
        found = inverse(arm, target, seed)
        assert_reaches(arm, found, target)
        assert cost(arm, found, seed) < cost(arm, known, seed) + 0.01


def test_hundred_times_finer_arm_angle_scan_is_hardly_better(arm: ArmModel, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(16)
    spheres = np.array(((0.5, 0.1, 0.3, 0.15), (-0.4, 0.2, 0.8, 0.1)))
    problems = [(arm.forward(known), seed) for known, seed in rng.uniform(arm.lower, arm.upper, (30, 2, 7))]
    costs = [cost(arm, inverse(arm, target, seed, keep_away=spheres), seed, spheres) for target, seed in problems]
    monkeypatch.setattr(srs, "_SCANS", (9000, 30))
    best = [cost(arm, inverse(arm, target, seed, keep_away=spheres), seed, spheres) for target, seed in problems]
    excess = np.subtract(costs, best)
    assert excess.min() > -1e-3
    assert np.quantile(excess, 0.9) < 1e-3  # the others lie in ways between the limits narrower than the scan


def test_a_comfortable_seed_is_the_answer_for_its_own_pose(arm: ArmModel) -> None:
    comfortable = 0
    for q in np.random.default_rng(12).uniform(arm.lower, arm.upper, (200, 7)):
        if cost(arm, q, q) == 0.0:
            comfortable += 1
            np.testing.assert_allclose(inverse(arm, arm.forward(q), q), q, atol=1e-9)
    assert comfortable > 20


def test_a_posture_at_a_limit_is_left_for_a_better_one(arm: ArmModel) -> None:
    q = READY.copy()
    q[4] = arm.upper[4] - 0.02
    found = inverse(arm, arm.forward(q), q)
    assert_reaches(arm, found, arm.forward(q))
    assert arm.upper[4] - found[4] > 0.08
    assert np.linalg.norm(found - q) < 1.0


def test_elbow_keeps_away_from_a_sphere(arm: ArmModel) -> None:
    target = arm.forward(READY)
    elbow, wrist = arm.joint_origins(READY)[[3, 5]]
    sphere = (*(0.7 * elbow + 0.3 * wrist), 0.05)
    found = inverse(arm, target, READY, keep_away=[sphere])
    assert_reaches(arm, found, target)
    elbow, wrist = arm.joint_origins(found)[[3, 5]]
    assert sphere_distances(elbow[None], wrist[None], np.array([sphere]))[0, 0] > 0.03
    np.testing.assert_array_equal(
        inverse(arm, target, READY, keep_away=[(5.0, 5.0, 5.0, 0.1)]), inverse(arm, target, READY)
    )


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


def test_near_poses_have_near_postures(arm: ArmModel) -> None:
    """Along a line, seeded with where the arm is, nothing flips."""
    q = READY
    for step in np.linspace(0.0, 0.15, 31):
        found = inverse(arm, arm.forward(READY) @ Transform.from_rotvec((0, step, -step), (0, 2 * step, 0)), q)
        assert np.abs(found - q).max() < 0.12
        q = found


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


def test_unreachable_pose_is_refused_with_its_distance(arm: ArmModel) -> None:
    far = Transform(np.eye(3), np.array((0.0, 0.0, arm.heights[7] + 0.05)))
    with pytest.raises(UnreachableError, match=r"too far.*50\.0 mm closer"):
        inverse(arm, far, READY)
    near = Transform(np.eye(3), np.array((0.1, 0.0, arm.heights[1] + arm.heights[7] - arm.heights[5])))
    with pytest.raises(UnreachableError, match=r"too near.*joint_4"):
        inverse(arm, near, READY)


def test_pose_beyond_a_joint_limit_names_the_joint(arm: ArmModel) -> None:
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
