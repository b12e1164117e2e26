"""Analysis of a pose log: jitter, drift, frozen frames and dropouts of the tracker, and agreement of the rows."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcmrs.formats.pose_log import ROWS, PoseLog
from pcmrs.spatial import Floats, Transform, distance, mean_transform, rotation_angle

__all__ = ["LoopCheck", "PoseJitter", "PoseTrack", "analyse_track", "check_loop"]

FEWEST = 3
"""Smallest number of poses that leaves a degree of freedom after fitting a straight line."""


@dataclass(frozen=True, eq=False, slots=True)
class PoseJitter:
    """Jitter and drift of a pose that should stand still; each (3,).

    Attributes:
        jitter: Standard deviation of the translation per axis of the parent frame, after a straight line over the
            samples is removed (n - 2), m.
        rotation_jitter: Likewise, of the rotation vectors about the body's axes, against the mean rotation, rad.
        drift: Change along that line from the first sample to the last, m.
        rotation_drift: Likewise, of the rotation vectors, rad.
    """

    jitter: Floats
    rotation_jitter: Floats
    drift: Floats
    rotation_drift: Floats


@dataclass(frozen=True, slots=True)
class PoseTrack:
    """One row of a log over all its samples.

    Attributes:
        name: Name of the row, as in `pcmrs.formats.pose_log.ROWS`.
        missing: Number of samples without this row.
        identities: Number of samples with the identity, which some software writes before anything was tracked.
        frozen: Number of samples with exactly the pose of the sample before: the tracker had no new frame.
        spread: Jitter and drift of the other poses; None for fewer than `FEWEST`.
    """

    name: str
    missing: int
    identities: int
    frozen: int
    spread: PoseJitter | None


@dataclass(frozen=True, slots=True)
class LoopCheck:
    """Deviation of body_tool from pol_body⁻¹ · pol_tool.

    Attributes:
        samples: Number of samples in which all three were tracked.
        max_distance: Largest distance, m.
        max_angle: Largest angle, rad.
    """

    samples: int
    max_distance: float
    max_angle: float


def seen(poses: Sequence[Transform | None]) -> list[Transform | None]:
    """Return the poses with None for each identity, which stands for a body that was not tracked yet."""
    return [None if pose is None or _same(pose, Transform.identity()) else pose for pose in poses]


def analyse_track(name: str, poses: Sequence[Transform | None]) -> PoseTrack:
    """Analyse one row of a log.

    Args:
        name: Name of the row.
        poses: Pose in each sample; None if it is missing.
    """
    tracked = seen(poses)
    missing = sum(pose is None for pose in poses)
    frozen = [False, *(_same(before, now) for before, now in itertools.pairwise(tracked))]
    fresh = [(sample, pose) for sample, pose in enumerate(tracked) if pose is not None and not frozen[sample]]
    spread = None
    if len(fresh) >= FEWEST:
        spread = _spread(np.array([sample for sample, _ in fresh], dtype=float), [pose for _, pose in fresh])
    return PoseTrack(name, missing, sum(pose is None for pose in tracked) - missing, sum(frozen), spread)


def check_loop(log: PoseLog) -> LoopCheck | None:
    """Compare body_tool with pol_body⁻¹ · pol_tool; return None if no sample has all three."""
    deviations = []
    for body_from_tool, tracker_from_body, tracker_from_tool in zip(
        *(seen(log.poses[row]) for row in ROWS), strict=True
    ):
        if body_from_tool is not None and tracker_from_body is not None and tracker_from_tool is not None:
            expected = tracker_from_body.inverse() @ tracker_from_tool
            deviations.append((distance(body_from_tool, expected), rotation_angle(body_from_tool, expected)))
    if not deviations:
        return None
    max_distance, max_angle = np.max(deviations, axis=0).tolist()
    return LoopCheck(len(deviations), max_distance, max_angle)


def _spread(samples: Floats, poses: list[Transform]) -> PoseJitter:
    mean_from_parent = mean_transform(poses).inverse()
    jitter, drift = _around_line(samples, np.array([pose.translation for pose in poses]))
    rotations = np.array([(mean_from_parent @ pose).rotvec for pose in poses])
    rotation_jitter, rotation_drift = _around_line(samples, rotations)
    return PoseJitter(jitter, rotation_jitter, drift, rotation_drift)


def _around_line(samples: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return the standard deviation of values (N, 3) around their least-squares line, and the line's rise."""
    lines = np.column_stack((np.ones_like(samples), samples))
    fitted = lines @ np.linalg.lstsq(lines, values)[0]
    deviation = np.sqrt(np.sum((values - fitted) ** 2, axis=0) / (len(samples) - 2))
    return deviation, fitted[-1] - fitted[0]


def _same(before: Transform | None, now: Transform | None) -> bool:
    if before is None or now is None:
        return False
    return np.array_equal(before.translation, now.translation) and np.array_equal(before.rotation, now.rotation)
