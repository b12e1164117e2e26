"""Hand-eye and robot-world calibration: the marker body on the flange, and the tracker in the robot's base, at once.

``A_i X = Y B_i`` with A = base_from_flange, X = flange_from_coil, Y = base_from_tracker, B = tracker_from_coil.
In closed form after M. Shah, Solving the Robot-World/Hand-Eye Calibration Problem Using the Kronecker Product, Journal
of Mechanisms and Robotics 5 (2013); then by Gauss-Newton, with rotations and translations each weighted by their own
scatter: far from the tracker its positions say more of the rotation of Y than its rotations do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from pcmrs.errors import GeometryError
from pcmrs.registration.pose_sets import check_count, check_turning, turning, without_bad_poses
from pcmrs.registration.rigid import cross_matrices
from pcmrs.spatial import Floats, Transform

FEWEST = 6
REMEDY = "bring the flange to postures turned about at least two axes by 30° and more"
ROUNDS = 8
"""Gauss-Newton steps: from Shah's solution three are enough to the last digit; the others are for the weights."""
SMALLEST_NOISE = 1e-7
"""No robot and no tracker is better, m and rad: the digits of numbers must not be taken for noise."""
MEDIAN = 2.366
"""Of the chi-squared distribution with three degrees of freedom."""


@dataclass(frozen=True, eq=False)
class HandEyeCalibration:
    """The marker body on the flange and the tracker beside the robot.

    Attributes:
        flange_from_coil: X, what the flange carries: the frame of its marker body.
        base_from_tracker: Y, while neither tracker nor robot is moved.
        rms: Root mean square of `distances` over the good poses, m.
        rms_angle: The same of `angles`, rad.
        distances: Between A X and Y B at every pose, the bad ones too, m, (N,).
        angles: The same of their rotations, rad, (N,).
        covariance: Of `flange_from_coil`, as far as the scatter of the poses shows it: rotation vector in the coil's
            frame (rad), then translation in the flange's (m), (6, 6).
        bad: Indices of the poses that do not fit the others and were left out.
        singular_values: See `pcmrs.registration.pose_sets.Turning`, (3,).
    """

    flange_from_coil: Transform
    base_from_tracker: Transform
    rms: float
    rms_angle: float
    distances: Floats
    angles: Floats
    covariance: Floats
    bad: tuple[int, ...]
    singular_values: Floats

    @property
    def deviations(self) -> Floats:
        """Standard deviation of the rotation about x y z of the coil, rad, and the translation, m, (6,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Parameters and whitened residuals; the rows of a pose are its rotation (3), then its translation (3)."""

    x: Transform
    y: Transform
    residuals: Floats
    jacobian: Floats
    smallest_noise: float


def calibrate_hand_eye(
    base_from_flange: Sequence[Transform], tracker_from_coil: Sequence[Transform]
) -> HandEyeCalibration:
    """The X and Y for which ``base_from_flange @ X`` and ``Y @ tracker_from_coil`` differ least.

    Args:
        base_from_flange: By the joints, with the arm at rest.
        tracker_from_coil: Seen at the same moments; tracker and robot base stand still.

    Raises:
        GeometryError: The numbers of poses differ.
        DegenerateMotionError: Fewer than `FEWEST` poses, or the flange was turned about one axis only.
        RefusalError: ``too_many_bad_poses``.
    """
    a, b = list(base_from_flange), list(tracker_from_coil)
    if len(a) != len(b):
        text = f"There are {len(a)} poses of the flange but {len(b)} of the tool; give them in pairs."
        raise GeometryError(text, flange=len(a), tool=len(b))
    check_count(len(a), FEWEST, REMEDY)
    rotations = np.array([pose.rotation for pose in a])

    def fit_to(chosen: list[int]) -> _Fit:
        check_turning(rotations[chosen], "flange", REMEDY)
        return _fit([a[index] for index in chosen], [b[index] for index in chosen])

    fit, good, bad = without_bad_poses(len(a), fit_to)
    differences = _differences(fit.x, fit.y, a, b)
    angles, distances = np.linalg.norm(differences, axis=2).T
    return HandEyeCalibration(
        flange_from_coil=fit.x,
        base_from_tracker=fit.y,
        rms=float(np.sqrt(np.mean(distances[good] ** 2))),
        rms_angle=float(np.sqrt(np.mean(angles[good] ** 2))),
        distances=distances,
        angles=angles,
        covariance=_covariance(fit),
        bad=bad,
        singular_values=turning(rotations[good]).singular_values,
    )


def closed_form(a: Sequence[Transform], b: Sequence[Transform]) -> tuple[Transform, Transform]:
    """Shah's X and Y.

    ``R_A R_X = R_Y R_B`` reads ``(R_B ⊗ R_A) vec R_X = vec R_Y``, so both are the first singular vectors of the sum of
    these Kronecker products; the translations follow from a linear system.
    """
    u, _, vt = np.linalg.svd(sum(np.kron(right.rotation, left.rotation) for left, right in zip(a, b, strict=True)))
    rotation_x, rotation_y = _nearest_rotation(vt[0]), _nearest_rotation(u[:, 0])
    left_sides = np.concatenate([np.hstack((pose.rotation, -np.eye(3))) for pose in a])
    right_sides = [rotation_y @ right.translation - left.translation for left, right in zip(a, b, strict=True)]
    solution = np.linalg.lstsq(left_sides, np.concatenate(right_sides), rcond=None)[0]
    return Transform(rotation_x, solution[:3]), Transform(rotation_y, solution[3:])


def _nearest_rotation(vector: Floats) -> Floats:
    """The rotation nearest to a matrix given column by column, (9,), up to a factor of either sign."""
    matrix = vector.reshape(3, 3).T
    u, _, vt = np.linalg.svd(matrix * np.sign(np.linalg.det(matrix)))
    nearest: Floats = u @ np.diag((1.0, 1.0, np.linalg.det(u @ vt))) @ vt
    return nearest


def _fit(a: Sequence[Transform], b: Sequence[Transform]) -> _Fit:
    """Weighted by the median, so that the weights do not follow a bad pose."""
    x, y = closed_form(a, b)
    for _ in range(ROUNDS):
        noise = _scatter(_differences(x, y, a, b))
        residuals, jacobian = _whitened(x, y, a, b, noise)
        step = np.linalg.lstsq(jacobian.reshape(-1, 12), -residuals.reshape(-1), rcond=None)[0]
        x, y = _moved(x, *step[:6].reshape(2, 3)), _moved(y, *step[6:].reshape(2, 3))
    return _Fit(x, y, *_whitened(x, y, a, b, noise), smallest_noise=float(SMALLEST_NOISE / noise.min()))


def _covariance(fit: _Fit) -> Floats:
    """Of the parameters of X, (6, 6), by the mean squares of rotations and of translations."""
    rows = fit.residuals.reshape(-1, 2, 3)
    found = np.sqrt(np.sum(rows**2, axis=(0, 2)) / (3 * len(rows) - 6))
    weights = np.repeat(np.maximum(found, fit.smallest_noise), 3)
    jacobian = fit.jacobian / weights[:, None]
    covariance: Floats = np.linalg.inv(np.einsum("nkp,nkq->pq", jacobian, jacobian))[:6, :6]
    return covariance


def _scatter(differences: Floats) -> Floats:
    """Standard deviation per axis of rotations, rad, and of translations, m, (2,)."""
    squares: Floats = np.median(np.sum(differences**2, axis=2), axis=0) / MEDIAN
    return np.sqrt(np.maximum(squares, SMALLEST_NOISE**2))


def _moved(pose: Transform, rotvec: npt.ArrayLike, shift: npt.ArrayLike) -> Transform:
    """Turned by a rotation vector in its own frame, shifted in the outer one."""
    rotation = pose.rotation @ Rotation.from_rotvec(np.asarray(rotvec)).as_matrix()
    return Transform(rotation, pose.translation + np.asarray(shift))


def _whitened(
    x: Transform, y: Transform, a: Sequence[Transform], b: Sequence[Transform], noise: Floats
) -> tuple[Floats, Floats]:
    """Residuals (N, 6) and Jacobian (N, 6, 12) over the noise of rotations and of translations (2,)."""
    weights = np.repeat(noise, 3)
    return _differences(x, y, a, b).reshape(-1, 6) / weights, _derivatives(y, a, b) / weights[:, None]


def _differences(x: Transform, y: Transform, a: Sequence[Transform], b: Sequence[Transform]) -> Floats:
    """Of A X from Y B: rotation vectors in the coil's frame, rad, and translations in the base, m, (N, 2, 3)."""
    by_arm, by_tracker = [pose @ x for pose in a], [y @ pose for pose in b]
    pairs = list(zip(by_arm, by_tracker, strict=True))
    turns = Rotation.from_matrix(np.array([seen.rotation.T @ reached.rotation for reached, seen in pairs]))
    shifts = np.array([reached.translation - seen.translation for reached, seen in pairs])
    return np.stack((turns.as_rotvec(), shifts), axis=1)


def _derivatives(y: Transform, a: Sequence[Transform], b: Sequence[Transform]) -> Floats:
    """Of the differences by rotation and translation of X, then of Y, where they are small, (N, 6, 12)."""
    derivatives = np.zeros((len(a), 6, 12))
    derivatives[:, :3, :3] = np.eye(3)
    derivatives[:, :3, 6:9] = [-pose.rotation.T for pose in b]
    derivatives[:, 3:, 3:6] = [pose.rotation for pose in a]
    derivatives[:, 3:, 6:9] = y.rotation @ cross_matrices(np.array([pose.translation for pose in b]))
    derivatives[:, 3:, 9:] = -np.eye(3)
    return derivatives
