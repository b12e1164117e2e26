"""What pivot and hand-eye calibration share: whether the motion fixes them, and which poses do not fit."""

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
"""Least rms rotation about the second axis, rad: below it, noise of the tracker is blown up more than ten times."""
FALSE_ALARM = 0.01
"""Probability that a set without a bad pose loses one, by each of two tests that seldom both err."""
SMALLEST_SHARE = 1e-9
"""Of a residual that the other poses check; less is none."""
MEDIAN_EFFICIENCY = 0.37
"""Of an estimate of the scatter by the median, against that by squares, for normal noise."""
MOST_BAD = 0.25
"""A set with a larger part of bad poses is refused: nobody could say which part is the bad one."""


@dataclass(frozen=True, eq=False)
class Turning:
    """How much a set of rotations turns.

    Attributes:
        singular_values: Root mean square deviation of the rotations along three directions of the moving frame,
            descending, (3,): sines of angles, nearly. The least is zero where all turn about one axis.
        axis: That axis in the moving frame: the direction that turns least, unit, (3,).
    """

    singular_values: Floats
    axis: Floats


class Fit(Protocol):
    """A least-squares fit to poses."""

    @property
    def residuals(self) -> Floats:
        """Of each pose, all of one variance, (N, k)."""

    @property
    def jacobian(self) -> Floats:
        """Derivative of the residuals by the parameters, (N, k, p)."""

    @property
    def smallest_noise(self) -> float:
        """Smaller residuals are the digits of numbers, not noise; in the unit of the residuals."""


F = TypeVar("F", bound=Fit)


def turning(rotations: npt.ArrayLike) -> Turning:
    """How much rotations (N, 3, 3) turn about their mean.

    A direction d of the moving frame that all rotations take to the same place is an axis they all share, so the
    deviations from the mean are singular exactly where there are no two axes that are not parallel (R. Y. Tsai,
    R. K. Lenz, A New Technique for Fully Autonomous and Efficient 3D Robotics Hand/Eye Calibration, IEEE Trans.
    Robotics and Automation 5, 1989).
    """
    matrices = np.asarray(rotations, dtype=float)
    deviations = (matrices - matrices.mean(axis=0)).reshape(-1, 3)
    _, values, directions = np.linalg.svd(deviations, full_matrices=False)
    return Turning(values / np.sqrt(len(matrices)), directions[2])


def check_count(count: int, fewest: int, remedy: str) -> None:
    """Raises `DegenerateMotionError` for fewer poses than `fewest`."""
    if count < fewest:
        text = f"{count} poses are too few, at least {fewest} are needed: {remedy}."
        raise DegenerateMotionError(text, count=count, limit=fewest)


def check_turning(rotations: Floats, moving: str, remedy: str) -> None:
    """Refuses poses that fix no calibration, and says about which axis alone they turn.

    Args:
        rotations: Of the moving frame in a fixed one, (N, 3, 3).
        moving: Name of the moving frame, for the text.
        remedy: What to do, for the text.

    Raises:
        DegenerateMotionError: They do not turn about two axes that are not parallel.
    """
    found = turning(rotations)
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
    """Fits, and leaves out poses one by one while the worst of them does not belong to the others.

    The test is that of a shifted mean: by how much the sum of squares falls when a pose is left out, against what the
    others show of the noise, an F distribution with Bonferroni's correction (R. D. Cook, S. Weisberg, Residuals and
    Influence in Regression, 1982). The fall is e^T (I - H)^-1 e with the pose's own block H of the hat matrix: nothing
    needs to be fitted anew for it.

    Args:
        count: Number of poses.
        fit: Fits the poses with these indices, or raises `DegenerateMotionError` where they fix nothing.

    Returns:
        The fit to the good poses, their indices, and those of the bad ones.

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
        if len(bad) > MOST_BAD * count:
            text = (
                f"More than {MOST_BAD:.0%} of the {count} poses do not fit the others, among them {sorted(bad)}: "
                "look for what moved or was swapped, and take the poses anew."
            )
            raise RefusalError("too_many_bad_poses", text, bad=sorted(bad), count=count)


def _worst(fit: Fit) -> tuple[int, float]:
    """The pose that fits least, and the chance of such a misfit in a set without a bad one."""
    residuals, jacobian = fit.residuals, fit.jacobian
    count, rows, parameters = jacobian.shape
    free = rows * (count - 1) - parameters
    if free <= 0:
        return 0, 1.0
    normal = np.linalg.inv(np.einsum("nkp,nkq->pq", jacobian, jacobian))
    hats = np.einsum("nkp,pq,nlq->nkl", jacobian, normal, jacobian)
    # A pose that alone fixes a direction leaves no residual there, so nothing can be said of it: pinv, not inv.
    apart = np.linalg.pinv(np.eye(rows) - hats, rcond=SMALLEST_SHARE, hermitian=True)
    falls = np.einsum("nk,nkl,nl->n", residuals, apart, residuals)
    worst, floor = int(np.argmax(falls)), fit.smallest_noise**2
    by_others = max((float(np.sum(residuals**2)) - falls[worst]) / free, floor)
    by_median = max(float(np.median(falls)) / stats.chi2.median(rows), floor)
    # Several bad poses hide each other in the sum of squares, but not in the median, which knows the noise less well.
    scale = falls[worst] / rows
    chances = stats.f.sf(scale / by_others, rows, free), stats.f.sf(scale / by_median, rows, MEDIAN_EFFICIENCY * free)
    return worst, float(min(chances))
