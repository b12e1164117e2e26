"""Pivot calibration: where the tip of a tracked pointer is, from poses taken while the tip rests on one point.

Z. Yaniv, Which Pivot Calibration?, SPIE Medical Imaging (2015): the algebraic one-step method. For every pose
``R_i tip + t_i = pivot``, which is linear in tip and pivot together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcmrs.registration.pose_sets import check_count, check_turning, turning, without_bad_poses
from pcmrs.spatial import Floats, Transform

FEWEST = 10
REMEDY = "keep the tip in place, tilt the pointer to all sides by 30° and more"

SMALLEST_NOISE = 1e-7
"""No tracker is better, m: the digits of numbers must not be taken for noise."""


@dataclass(frozen=True, eq=False)
class PivotCalibration:
    """The tip of a pointer.

    Attributes:
        tip_in_pointer: In the pointer's marker body, m, (3,).
        pivot_in_tracker: The point on which it rested, m, (3,).
        rms: Root mean square distance of the tip from the pivot over the good poses, m.
        distances: The same of every pose, the bad ones too, m, (N,).
        covariance: Of `tip_in_pointer` as far as the scatter of the poses shows it, m², (3, 3); an error that all
            poses share is not in it.
        bad: Indices of the poses that do not fit the others and were left out.
        singular_values: See `pcmrs.registration.pose_sets.Turning`, (3,).
    """

    tip_in_pointer: Floats
    pivot_in_tracker: Floats
    rms: float
    distances: Floats
    covariance: Floats
    bad: tuple[int, ...]
    singular_values: Floats

    @property
    def deviations(self) -> Floats:
        """Standard deviation of the tip along each axis of the marker body, m, (3,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, eq=False)
class _Fit:
    solution: Floats
    residuals: Floats
    jacobian: Floats
    smallest_noise: float = SMALLEST_NOISE


def calibrate_pivot(tracker_from_pointer: Sequence[Transform]) -> PivotCalibration:
    """The tip that stays nearest to one point.

    Args:
        tracker_from_pointer: Poses of the pointer while its tip rests on one point.

    Raises:
        DegenerateMotionError: Fewer than `FEWEST` poses, or the pointer was turned about one axis only.
        RefusalError: ``too_many_bad_poses``.
    """
    poses = list(tracker_from_pointer)
    check_count(len(poses), FEWEST, REMEDY)
    rotations = np.array([pose.rotation for pose in poses])
    positions = np.array([pose.translation for pose in poses])

    def fit_to(chosen: list[int]) -> _Fit:
        check_turning(rotations[chosen], "pointer", REMEDY)
        return _fit(rotations[chosen], positions[chosen])

    fit, good, bad = without_bad_poses(len(poses), fit_to)
    tip, pivot = fit.solution[:3], fit.solution[3:]
    distances = np.linalg.norm(rotations @ tip + positions - pivot, axis=1)
    flat = fit.jacobian.reshape(-1, 6)
    variance = np.sum(fit.residuals**2) / (len(flat) - 6)
    return PivotCalibration(
        tip_in_pointer=tip,
        pivot_in_tracker=pivot,
        rms=float(np.sqrt(np.mean(distances[good] ** 2))),
        distances=distances,
        covariance=(variance * np.linalg.inv(flat.T @ flat))[:3, :3],
        bad=bad,
        singular_values=turning(rotations[good]).singular_values,
    )


def _fit(rotations: Floats, positions: Floats) -> _Fit:
    """Least squares of ``[R_i, -I] (tip, pivot) = -t_i``, about the mean position: that keeps the digits."""
    middle = positions.mean(axis=0)
    jacobian = np.concatenate((rotations, np.broadcast_to(-np.eye(3), rotations.shape)), axis=2)
    right = (middle - positions).reshape(-1)
    solution = np.linalg.lstsq(jacobian.reshape(-1, 6), right, rcond=None)[0]
    residuals = (jacobian @ solution).reshape(-1) - right
    solution[3:] += middle
    return _Fit(solution, residuals.reshape(-1, 3), jacobian)
