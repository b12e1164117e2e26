"""Inverse kinematics in closed form: singular and unreachable poses, and the scan of the arm angle."""

import numpy as np
import pytest

from pcmrs.errors import UnreachableError
from pcmrs.kinematics import _srs as srs
from pcmrs.kinematics._posture import cost
from pcmrs.kinematics.arms import ARMS
from pcmrs.kinematics.inverse import inverse
from pcmrs.kinematics.model import ArmModel
from pcmrs.spatial import Transform
from tests.support.trials import run_counts
from tests.unit.kinematics.arm_models import heights
from tests.unit.kinematics.reached_poses import READY, assert_reaches


@pytest.fixture(params=list(ARMS))
def arm(request: pytest.FixtureRequest) -> ArmModel:
    return ArmModel(ARMS[request.param])


@run_counts(20, nightly=60)
def test_hundred_times_finer_arm_angle_scan_is_hardly_better(
    arm: ArmModel, monkeypatch: pytest.MonkeyPatch, runs: int
) -> None:
    rng = np.random.default_rng(16)
    spheres = np.array(((0.5, 0.1, 0.3, 0.15), (-0.4, 0.2, 0.8, 0.1)))
    problems = [(arm.forward(known), seed) for known, seed in rng.uniform(arm.lower, arm.upper, (runs, 2, 7))]
    costs = [cost(arm, inverse(arm, target, seed, keep_away=spheres), seed, spheres) for target, seed in problems]
    monkeypatch.setattr(srs, "_SCANS", (9000, 30))
    best = [cost(arm, inverse(arm, target, seed, keep_away=spheres), seed, spheres) for target, seed in problems]
    excess = np.subtract(costs, best)
    assert excess.min() > -1e-3
    assert np.quantile(excess, 0.9) < 1e-3  # the others lie in ways between the limits narrower than the scan


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


def test_unreachable_pose_is_refused_with_its_distance(arm: ArmModel) -> None:
    _, shoulder, _, _, _, wrist, _, flange = heights(arm).tolist()
    far = Transform(np.eye(3), np.array((0.0, 0.0, flange + 0.05)))
    with pytest.raises(UnreachableError, match=r"too far.*50\.0 mm closer"):
        inverse(arm, far, READY)
    near = Transform(np.eye(3), np.array((0.1, 0.0, shoulder + flange - wrist)))
    with pytest.raises(UnreachableError, match=r"too near.*joint_4"):
        inverse(arm, near, READY)


def test_pose_beyond_a_joint_limit_names_the_joint(arm: ArmModel) -> None:
    stretched_by_limits = arm.forward((0, 0, 0, -1.5, 0, arm.upper[5] + 0.3, 0))
    with pytest.raises(UnreachableError, match="joint limit") as caught:
        inverse(arm, stretched_by_limits, READY, joint_margin=0.5)
    assert caught.value.fields["joint"].startswith("joint_")
