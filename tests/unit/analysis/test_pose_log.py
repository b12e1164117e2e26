"""Pose logs with known jitter, drift, gaps and frozen frames."""

from __future__ import annotations

import numpy as np
import pytest

from pcmrs.analysis.pose_log import analyse_track, check_loop
from pcmrs.formats.pose_log import PoseLog
from pcmrs.spatial import Transform

PLACE = Transform.from_rotvec((0.1, -0.05, -0.9), (0.3, -1.1, 0.6))
DRIFT = np.array((2e-4, -1e-4, 3e-4))
JITTER = np.array((3e-5, 5e-5, 1e-4))
ROTATION_JITTER = np.radians((0.02, 0.03, 0.01))


def _poses(samples: int, seed: int = 1) -> list[Transform | None]:
    """A pose that drifts along a line and jitters in the tracker frame, and turns about the body's own axes."""
    rng = np.random.default_rng(seed)
    return [
        Transform(PLACE.rotation, PLACE.translation + share * DRIFT + rng.normal(size=3) * JITTER)
        @ Transform.from_rotvec(np.zeros(3), rng.normal(size=3) * ROTATION_JITTER)
        for share in np.linspace(0.0, 1.0, samples)
    ]


def test_jitter_and_drift_are_separated() -> None:
    track = analyse_track("pol_tool", _poses(4000))
    assert track.spread is not None
    # The standard deviation of a standard deviation is sigma / sqrt(2 n): 1.1 % here.
    assert track.spread.jitter == pytest.approx(JITTER, rel=0.05)
    assert track.spread.rotation_jitter == pytest.approx(ROTATION_JITTER, rel=0.05)
    # Both ends of a fitted line are uncertain by 2 sigma / sqrt(n) together.
    assert track.spread.drift == pytest.approx(DRIFT, abs=5e-5 * 2 * 5 / np.sqrt(4000) * 2)
    assert np.abs(track.spread.rotation_drift).max() < np.radians(0.01)


def test_the_jitter_of_short_logs_is_unbiased() -> None:
    spreads = [analyse_track("pol_tool", _poses(5, seed)).spread for seed in range(400)]
    variances = np.mean([spread.jitter**2 for spread in spreads if spread is not None], axis=0)
    assert variances == pytest.approx(JITTER**2, rel=0.2)  # dividing by n would halve it


def test_missing_identity_and_frozen_frames_do_not_change_jitter() -> None:
    poses = _poses(300)
    clean = analyse_track("pol_body", [*poses[:10], *poses[20:]])
    poses[10] = poses[11] = None
    poses[12] = poses[13] = poses[14] = Transform.identity()
    for frozen in range(15, 20):
        poses[frozen] = poses[frozen - 1] if frozen > 15 else poses[20]
    poses[20] = poses[19]
    track = analyse_track("pol_body", poses)
    assert (track.missing, track.identities, track.frozen) == (2, 3, 5)
    assert clean.spread is not None
    assert track.spread is not None
    assert track.spread.jitter == pytest.approx(clean.spread.jitter, rel=0.02)


@pytest.mark.parametrize("poses", [[None] * 4, [Transform.identity()] * 4, [PLACE] * 4, _poses(2)])
def test_too_few_poses_have_no_jitter(poses: list[Transform | None]) -> None:
    assert analyse_track("pol_tool", poses).spread is None


def _log(body_from_tool: Transform | None, *, tracker_from_body: Transform | None) -> PoseLog:
    tracker_from_tool = PLACE @ Transform.from_rotvec((0.06, 0.0, 0.08), (0.5, 0.1, 1.9))
    series: dict[str, list[Transform | None]] = {
        "body_tool": [PLACE.inverse() @ tracker_from_tool, body_from_tool],
        "pol_body": [PLACE, tracker_from_body],
        "pol_tool": [tracker_from_tool, tracker_from_tool],
    }
    return PoseLog("poses_1", series)


def test_rows_that_disagree_are_found() -> None:
    agreed = _log(None, tracker_from_body=PLACE).poses["body_tool"][0]
    assert agreed is not None
    other = agreed @ Transform.from_rotvec((0.0, 0.003, -0.004), (0.01, 0.0, 0.0))
    check = check_loop(_log(other, tracker_from_body=PLACE))
    assert check is not None
    assert check.samples == 2
    assert check.max_distance == pytest.approx(0.005)
    assert check.max_angle == pytest.approx(0.01)


@pytest.mark.parametrize("lost", [None, Transform.identity()])
def test_samples_with_a_lost_body_are_not_compared(lost: Transform | None) -> None:
    check = check_loop(_log(PLACE, tracker_from_body=lost))
    assert check is not None
    assert check.samples == 1
    assert check.max_distance < 1e-12


def test_without_a_complete_sample_nothing_is_compared() -> None:
    log = _log(PLACE, tracker_from_body=PLACE)
    log.poses["pol_tool"][:] = [None, None]
    assert check_loop(log) is None
