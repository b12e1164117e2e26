"""Hand-eye and robot-world calibration in one solution: marker body on the flange, tracker in the robot's base.

It solves ``A_i X = Y B_i`` with A = base_from_flange, X = flange_from_tool_marker, Y = base_from_tracker and B =
tracker_from_tool_marker. The closed form is that of M. Shah, Solving the Robot-World/Hand-Eye Calibration Problem Using
the Kronecker Product, Journal of Mechanisms and Robotics 5 (2013). Gauss-Newton steps follow, with rotations and
translations each weighted by their own scatter: far from the tracker, its positions determine the rotation of Y better
than its rotations do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from pcmrs.errors import GeometryError
from pcmrs.registration.pose_sets import check_count, check_rotation_spread, rotation_spread, without_bad_poses
from pcmrs.registration.rigid import cross_matrices
from pcmrs.spatial import Floats, Transform

__all__ = ["HandEyeCalibration", "calibrate_hand_eye"]

MIN_POSES = 6
REMEDY = "bring the flange to postures turned about at least two axes by 30° and more"
ROUNDS = 8
"""Number of Gauss-Newton steps. From Shah's solution three converge to the last digit; the others adapt the weights."""
MIN_NOISE = 1e-7
"""Least noise, m and rad. No robot and no tracker is better, and rounding must not be taken for noise."""
MEDIAN = 2.366
"""Median of the chi-squared distribution with three degrees of freedom."""


@dataclass(frozen=True, eq=False)
class HandEyeCalibration:
    """Poses of the marker body on the flange and of the tracker in the robot's base.

    Attributes:
        flange_from_tool_marker: X, the pose of the marker body on the flange.
        base_from_tracker: Y, valid until the tracker or the robot is moved.
        rms: Root mean square of `distances` over the good poses, m.
        rms_angle: Root mean square of `angles` over the good poses, rad.
        distances: Distance between A X and Y B at every pose, including the bad ones, m, (N,).
        angles: Angle between A X and Y B at every pose, including the bad ones, rad, (N,).
        covariance: Covariance of `flange_from_tool_marker` as far as the scatter of the poses shows it: rotation vector
            in the frame of the marker body (rad), then translation in the flange's frame (m), (6, 6).
        bad: Indices of the poses that do not fit the others and were left out.
        singular_values: Singular values of `pcmrs.registration.pose_sets.RotationSpread`, (3,).
    """

    flange_from_tool_marker: Transform
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
        """Standard deviations of the rotation about the coil's x, y, z axes, rad, and of the translation, m, (6,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Parameters, whitened residuals (N, 6) and their Jacobian (N, 6, 12). Rotations come first, then translations."""

    x: Transform
    y: Transform
    residuals: Floats
    jacobian: Floats
    smallest_noise: float


def calibrate_hand_eye(
    base_from_flange: Sequence[Transform], tracker_from_tool_marker: Sequence[Transform]
) -> HandEyeCalibration:
    """Return the X and Y for which ``base_from_flange @ X`` and ``Y @ tracker_from_tool_marker`` differ least.

    Args:
        base_from_flange: Poses of the flange computed from the joints, with the arm at rest, (N,).
        tracker_from_tool_marker: Poses of the marker body measured at the same times, (N,). The tracker and the robot's
            base must not move.

    Raises:
        GeometryError: The numbers of poses differ.
        DegenerateMotionError: There are fewer than `MIN_POSES` poses, or the flange was turned about one axis only.
        RefusalError: ``too_many_bad_poses``.
    """
    a, b = list(base_from_flange), list(tracker_from_tool_marker)
    if len(a) != len(b):
        text = f"There are {len(a)} poses of the flange but {len(b)} of the tool; give them in pairs."
        raise GeometryError(text, flange=len(a), tool=len(b))
    check_count(len(a), MIN_POSES, REMEDY)
    rotations = np.array([pose.rotation for pose in a])

    def fit_to(chosen: list[int]) -> _Fit:
        check_rotation_spread(rotations[chosen], "flange", REMEDY)
        return _fit([a[index] for index in chosen], [b[index] for index in chosen])

    fit, good, bad = without_bad_poses(len(a), fit_to)
    differences = _differences(fit.x, fit.y, a, b)
    angles, distances = np.linalg.norm(differences, axis=2).T
    return HandEyeCalibration(
        flange_from_tool_marker=fit.x,
        base_from_tracker=fit.y,
        rms=float(np.sqrt(np.mean(distances[good] ** 2))),
        rms_angle=float(np.sqrt(np.mean(angles[good] ** 2))),
        distances=distances,
        angles=angles,
        covariance=_covariance(fit),
        bad=bad,
        singular_values=rotation_spread(rotations[good]).singular_values,
    )


def closed_form(a: Sequence[Transform], b: Sequence[Transform]) -> tuple[Transform, Transform]:
    """Return Shah's X and Y.

    ``R_A R_X = R_Y R_B`` is equivalent to ``(R_B ⊗ R_A) vec R_X = vec R_Y``, so R_X and R_Y are the first singular
    vectors of the sum of these Kronecker products. The translations follow from a linear system.

    Args:
        a: Poses of the flange in the robot's base, (N,).
        b: Poses of the marker body in the tracker, (N,).
    """
    u, _, vt = np.linalg.svd(sum(np.kron(right.rotation, left.rotation) for left, right in zip(a, b, strict=True)))
    rotation_x, rotation_y = _nearest_rotation(vt[0]), _nearest_rotation(u[:, 0])
    left_sides = np.concatenate([np.hstack((pose.rotation, -np.eye(3))) for pose in a])
    right_sides = [rotation_y @ right.translation - left.translation for left, right in zip(a, b, strict=True)]
    solution = np.linalg.lstsq(left_sides, np.concatenate(right_sides), rcond=None)[0]
    return Transform(rotation_x, solution[:3]), Transform(rotation_y, solution[3:])


def _nearest_rotation(vector: Floats) -> Floats:
    """Return the rotation nearest to a matrix given column by column, (9,), up to a factor of either sign."""
    matrix = vector.reshape(3, 3).T
    # A singular vector has either sign, but a rotation has a positive determinant.
    u, _, vt = np.linalg.svd(matrix * np.sign(np.linalg.det(matrix)))
    nearest: Floats = u @ np.diag((1.0, 1.0, np.linalg.det(u @ vt))) @ vt
    return nearest


def _fit(a: Sequence[Transform], b: Sequence[Transform]) -> _Fit:
    """Fit X and Y, weighted by the median of the differences, so that the weights do not follow a bad pose."""
    x, y = closed_form(a, b)
    for _ in range(ROUNDS):
        noise = _scatter(_differences(x, y, a, b))
        residuals, jacobian = _whitened(x, y, a, b, noise)
        step = np.linalg.lstsq(jacobian.reshape(-1, 12), -residuals.reshape(-1), rcond=None)[0]
        x, y = _moved(x, *step[:6].reshape(2, 3)), _moved(y, *step[6:].reshape(2, 3))
    return _Fit(x, y, *_whitened(x, y, a, b, noise), smallest_noise=float(MIN_NOISE / noise.min()))


def _covariance(fit: _Fit) -> Floats:
    """Return the covariance of the parameters of X, (6, 6), from the mean squares of rotations and of translations."""
    rows = fit.residuals.reshape(-1, 2, 3)
    # Half of the 12 parameters are rotations, and half are translations.
    found = np.sqrt(np.sum(rows**2, axis=(0, 2)) / (3 * len(rows) - 6))
    weights = np.repeat(np.maximum(found, fit.smallest_noise), 3)
    jacobian = fit.jacobian / weights[:, None]
    covariance: Floats = np.linalg.inv(np.einsum("nkp,nkq->pq", jacobian, jacobian))[:6, :6]
    return covariance


def _scatter(differences: Floats) -> Floats:
    """Return the standard deviation per axis of rotations, rad, and of translations, m, (2,)."""
    squares: Floats = np.median(np.sum(differences**2, axis=2), axis=0) / MEDIAN
    return np.sqrt(np.maximum(squares, MIN_NOISE**2))


def _moved(pose: Transform, rotvec: npt.ArrayLike, shift: npt.ArrayLike) -> Transform:
    """Return a pose turned by a rotation vector in its own frame and shifted in the outer frame."""
    rotation = pose.rotation @ Rotation.from_rotvec(np.asarray(rotvec)).as_matrix()
    return Transform(rotation, pose.translation + np.asarray(shift))


def _whitened(
    x: Transform, y: Transform, a: Sequence[Transform], b: Sequence[Transform], noise: Floats
) -> tuple[Floats, Floats]:
    """Return residuals (N, 6) and Jacobian (N, 6, 12), divided by the noise of rotations and of translations (2,)."""
    weights = np.repeat(noise, 3)
    return _differences(x, y, a, b).reshape(-1, 6) / weights, _derivatives(y, a, b) / weights[:, None]


def _differences(x: Transform, y: Transform, a: Sequence[Transform], b: Sequence[Transform]) -> Floats:
    """Return the differences of A X from Y B, (N, 2, 3).

    Each is a rotation vector in the coil's frame, rad, and a translation in the robot's base, m.
    """
    by_arm, by_tracker = [pose @ x for pose in a], [y @ pose for pose in b]
    pairs = list(zip(by_arm, by_tracker, strict=True))
    turns = Rotation.from_matrix(np.array([seen.rotation.T @ reached.rotation for reached, seen in pairs]))
    shifts = np.array([reached.translation - seen.translation for reached, seen in pairs])
    return np.stack((turns.as_rotvec(), shifts), axis=1)


def _derivatives(y: Transform, a: Sequence[Transform], b: Sequence[Transform]) -> Floats:
    """Return the derivatives of small differences by rotation and translation of X, then of Y, (N, 6, 12)."""
    derivatives = np.zeros((len(a), 6, 12))
    derivatives[:, :3, :3] = np.eye(3)
    derivatives[:, :3, 6:9] = [-pose.rotation.T for pose in b]
    derivatives[:, 3:, 3:6] = [pose.rotation for pose in a]
    derivatives[:, 3:, 6:9] = y.rotation @ cross_matrices(np.array([pose.translation for pose in b]))
    derivatives[:, 3:, 9:] = -np.eye(3)
    return derivatives
