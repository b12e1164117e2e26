"""Pivot calibration: the tip of a tracked pointer, from poses measured while the tip rests on one point.

Z. Yaniv, Which Pivot Calibration?, SPIE Medical Imaging (2015): the algebraic one-step method. Every pose gives
``R_i tip + t_i = pivot``, which is linear in tip and pivot together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcmrs.registration.pose_sets import check_count, check_rotation_spread, rotation_spread, without_bad_poses
from pcmrs.spatial import Floats, Transform

__all__ = ["PivotCalibration", "calibrate_pivot"]

MIN_POSES = 10
REMEDY = "keep the tip in place, tilt the pointer to all sides by 30° and more"

MIN_NOISE = 1e-7
"""Least noise, m. No tracker is better, and rounding must not be taken for noise."""


@dataclass(frozen=True, eq=False)
class PivotCalibration:
    """Tip of a pointer.

    Attributes:
        tip_in_pointer: Tip in the frame of the pointer's marker body, m, (3,).
        pivot_in_tracker: Point in the tracker frame on which the tip rested, m, (3,).
        rms: Root mean square distance of the tip from the pivot over the good poses, m.
        distances: Distance of the tip from the pivot at every pose, including the bad ones, m, (N,).
        covariance: Covariance of `tip_in_pointer` as far as the scatter of the poses shows it, m², (3, 3). It does not
            contain errors that all poses share.
        bad: Indices of the poses that do not fit the others and were left out.
        singular_values: Singular values of `pcmrs.registration.pose_sets.RotationSpread`, (3,).
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
    smallest_noise: float = MIN_NOISE


def calibrate_pivot(tracker_from_pointer: Sequence[Transform]) -> PivotCalibration:
    """Return the tip that stays nearest to one point.

    Args:
        tracker_from_pointer: Poses of the pointer in the tracker frame while its tip rests on one point.

    Raises:
        DegenerateMotionError: There are fewer than `MIN_POSES` poses, or the pointer was turned about one axis only.
        RefusalError: ``too_many_bad_poses``.
    """
    poses = list(tracker_from_pointer)
    check_count(len(poses), MIN_POSES, REMEDY)
    rotations = np.array([pose.rotation for pose in poses])
    positions = np.array([pose.translation for pose in poses])

    def fit_to(chosen: list[int]) -> _Fit:
        check_rotation_spread(rotations[chosen], "pointer", REMEDY)
        return _fit(rotations[chosen], positions[chosen])

    fit, good, bad = without_bad_poses(len(poses), fit_to)
    tip, pivot = fit.solution[:3], fit.solution[3:]
    distances = np.linalg.norm(rotations @ tip + positions - pivot, axis=1)
    flat = fit.jacobian.reshape(-1, 6)
    # The fit has 6 parameters: tip and pivot.
    variance = np.sum(fit.residuals**2) / (len(flat) - 6)
    return PivotCalibration(
        tip_in_pointer=tip,
        pivot_in_tracker=pivot,
        rms=float(np.sqrt(np.mean(distances[good] ** 2))),
        distances=distances,
        covariance=(variance * np.linalg.inv(flat.T @ flat))[:3, :3],
        bad=bad,
        singular_values=rotation_spread(rotations[good]).singular_values,
    )


def _fit(rotations: Floats, positions: Floats) -> _Fit:
    """Solve ``[R_i, -I] (tip, pivot) = -t_i`` by least squares, relative to the mean position to keep the digits."""
    middle = positions.mean(axis=0)
    jacobian = np.concatenate((rotations, np.broadcast_to(-np.eye(3), rotations.shape)), axis=2)
    right = (middle - positions).reshape(-1)
    solution = np.linalg.lstsq(jacobian.reshape(-1, 6), right, rcond=None)[0]
    residuals = (jacobian @ solution).reshape(-1) - right
    solution[3:] += middle
    return _Fit(solution, residuals.reshape(-1, 3), jacobian)
