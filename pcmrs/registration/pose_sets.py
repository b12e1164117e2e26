"""Checks that pivot and hand-eye calibration share: sufficient rotation, and poses that do not fit the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from scipy import stats

from pcmrs.errors import DegenerateMotionError, RefusalError
from pcmrs.spatial import Floats

MIN_TURN = np.radians(5.0)
"""Least rms rotation about the second axis, rad. Below it, the tracker's noise is amplified more than ten times."""
FALSE_ALARM = 0.01
"""Probability that a set without a bad pose loses one, by each of two tests that seldom err together."""
SMALLEST_SHARE = 1e-9
"""Least share of a residual that the other poses check. A smaller one counts as none."""
MEDIAN_EFFICIENCY = 0.37
"""Efficiency of an estimate of the scatter by the median, relative to that by squares, for normal noise."""
MAX_BAD_SHARE = 0.25
"""Largest share of bad poses. With more, it is not clear which poses are the bad ones."""


@dataclass(frozen=True, eq=False)
class RotationSpread:
    """Spread of a set of rotations.

    Attributes:
        singular_values: Root mean square deviations of the rotations along three directions of the moving frame,
            descending, (3,). They are nearly sines of angles. The least is zero if all rotations are about one axis.
        axis: That axis in the moving frame, as the direction that turns least, unit vector, (3,).
    """

    singular_values: Floats
    axis: Floats


class Fit(Protocol):
    """A least-squares fit to poses."""

    @property
    def residuals(self) -> Floats:
        """Residuals of each pose, all of one variance, (N, k)."""

    @property
    def jacobian(self) -> Floats:
        """Derivatives of the residuals by the parameters, (N, k, p)."""

    @property
    def smallest_noise(self) -> float:
        """Least noise in the unit of the residuals; smaller residuals are rounding, not noise."""


F = TypeVar("F", bound=Fit)


def rotation_spread(rotations: npt.ArrayLike) -> RotationSpread:
    """Return the spread of rotations (N, 3, 3) about their mean.

    A direction d of the moving frame that all rotations map to the same direction is an axis that they all share. The
    deviations from the mean are therefore singular exactly if there are no two axes that are not parallel (R. Y. Tsai,
    R. K. Lenz, A New Technique for Fully Autonomous and Efficient 3D Robotics Hand/Eye Calibration, IEEE Trans.
    Robotics and Automation 5, 1989).
    """
    matrices = np.asarray(rotations, dtype=float)
    deviations = (matrices - matrices.mean(axis=0)).reshape(-1, 3)
    _, values, directions = np.linalg.svd(deviations, full_matrices=False)
    return RotationSpread(values / np.sqrt(len(matrices)), directions[2])


def check_count(count: int, fewest: int, remedy: str) -> None:
    """Raise an error if there are too few poses.

    Args:
        count: Number of poses.
        fewest: Least number of poses.
        remedy: What to do, for the error text.

    Raises:
        DegenerateMotionError: There are fewer poses than `fewest`.
    """
    if count < fewest:
        text = f"{count} poses are too few, at least {fewest} are needed: {remedy}."
        raise DegenerateMotionError(text, count=count, limit=fewest)


def check_rotation_spread(rotations: Floats, moving: str, remedy: str) -> None:
    """Raise an error if the poses do not determine a calibration; its text names the only axis about which they turn.

    Args:
        rotations: Rotations of the moving frame in a fixed one, (N, 3, 3).
        moving: Name of the moving frame, for the error text.
        remedy: What to do, for the error text.

    Raises:
        DegenerateMotionError: The poses do not turn about two axes that are not parallel.
    """
    found = rotation_spread(rotations)
    if found.singular_values[2] >= MIN_TURN:
        return
    values = ", ".join(f"{np.degrees(value):.2f}°" for value in found.singular_values)
    axis = " ".join(f"{component:.2f}" for component in found.axis)
    which = "hardly turn at all" if found.singular_values[0] < MIN_TURN else f"turn about the axis ({axis}) only"
    text = (
        f"The poses {which}, in the frame of the {moving}: rms rotation {values}, the least must be "
        f"{np.degrees(MIN_TURN):g}°. Rotations about other axes are missing: {remedy}."
    )
    fields = {"singular_values": found.singular_values.tolist(), "axis": found.axis.tolist()}
    raise DegenerateMotionError(text, limit=float(MIN_TURN), **fields)


def without_bad_poses(count: int, fit: Callable[[list[int]], F]) -> tuple[F, list[int], tuple[int, ...]]:
    """Fit, and leave out poses one by one as long as the worst of them does not fit the others.

    It is the mean-shift test: the reduction of the sum of squares by leaving out a pose is compared with the noise that
    the other poses show, as an F distribution with Bonferroni's correction (R. D. Cook, S. Weisberg, Residuals and
    Influence in Regression, 1982). The reduction is e^T (I - H)^-1 e with the pose's own block H of the hat matrix, so
    that no new fit is needed.

    Args:
        count: Number of poses.
        fit: Function that fits the poses with the given indices. It raises `DegenerateMotionError` if they do not
            determine the parameters.

    Returns:
        The fit to the good poses, their indices, and the indices of the bad ones.

    Raises:
        RefusalError: ``too_many_bad_poses``.
    """
    good, bad = list(range(count)), list[int]()
    while True:
        found = fit(good)
        worst, chance = _worst(found)
        if chance * len(good) >= FALSE_ALARM:
            return found, good, tuple(sorted(bad))
        bad.append(good.pop(worst))
        if len(bad) > MAX_BAD_SHARE * count:
            text = (
                f"More than {MAX_BAD_SHARE:.0%} of the {count} poses do not fit the others, among them {sorted(bad)}: "
                "look for what moved or was swapped, and take the poses again."
            )
            raise RefusalError("too_many_bad_poses", text, bad=sorted(bad), count=count)


def _worst(fit: Fit) -> tuple[int, float]:
    """Return the pose that fits least, and the probability of such a misfit in a set without a bad pose."""
    residuals, jacobian = fit.residuals, fit.jacobian
    count, rows, parameters = jacobian.shape
    free = rows * (count - 1) - parameters
    if free <= 0:
        return 0, 1.0
    normal = np.linalg.inv(np.einsum("nkp,nkq->pq", jacobian, jacobian))
    hats = np.einsum("nkp,pq,nlq->nkl", jacobian, normal, jacobian)
    # A pose that alone determines a direction leaves no residual in it and cannot be tested there: pinv, not inv.
    inverses = np.linalg.pinv(np.eye(rows) - hats, rcond=SMALLEST_SHARE, hermitian=True)
    falls = np.einsum("nk,nkl,nl->n", residuals, inverses, residuals)
    worst, floor = int(np.argmax(falls)), fit.smallest_noise**2
    by_others = max((float(np.sum(residuals**2)) - falls[worst]) / free, floor)
    by_median = max(float(np.median(falls)) / stats.chi2.median(rows), floor)
    # Several bad poses mask each other in the sum of squares, but not in the less efficient median.
    scale = falls[worst] / rows
    chances = stats.f.sf(scale / by_others, rows, free), stats.f.sf(scale / by_median, rows, MEDIAN_EFFICIENCY * free)
    return worst, float(min(chances))
