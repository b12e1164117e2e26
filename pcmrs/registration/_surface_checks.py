"""Checks of `refine_with_surface`: when a surface does not help a registration, and what to do then."""

from __future__ import annotations

import math

import numpy as np

from pcmrs.errors import RefusalError
from pcmrs.spatial import Floats, Transform

MIN_POINTS = 20
"""Least number of surface points after trimming: about three times the degrees of freedom of a rigid motion."""
MAX_START_RATIO = 4.0
"""Largest median distance of the points from the surface, in standard deviations that landmarks and probe explain. 0.7
to 2 is usual."""
MIN_CURVATURE = 0.03
"""Least second eigenvalue of the mean of n nᵀ. Below it, all normals are within about 20° of one direction, as on a
flat patch."""
MAX_STEP = 22.46
"""Largest squared step of the registration in standard deviations of the landmarks: the 99.9 % quantile of chi-squared
with 6 degrees of freedom."""
MAX_MISFIT = 2.0
"""Largest rms distance of the inliers, relative to what `sigma_surface` and the trimming explain."""
MIN_GAIN = 0.02
"""Least share of the TRE that a refinement must remove. Less is not worth a departure from the landmarks alone."""


def check_count(touched: int, inliers: int) -> None:
    """Raise an error if so few points remain that six degrees of freedom would fit their noise.

    Args:
        touched: Number of touched points.
        inliers: Number of points that remain after trimming.
    """
    if inliers < MIN_POINTS:
        text = (
            f"{touched} points of the surface leave {inliers} after trimming, at least {MIN_POINTS} are needed; "
            "touch more."
        )
        raise RefusalError("too_few_surface_points", text, count=inliers, limit=MIN_POINTS)


def check_near(distances: Floats, deviations: Floats) -> None:
    """Raise an error if the start is so far away that nearest points mean nothing: a wrong mesh, unit or orientation.

    Args:
        distances: Distances of the touched points from the surface, m, (K,).
        deviations: Standard deviations of these distances that landmarks and probe explain, m, (K,).
    """
    ratio, median = float(np.median(distances / deviations)), float(np.median(distances))
    if not ratio <= MAX_START_RATIO:
        text = (
            f"Half of the touched points are {median * 1000:.4g} mm or more from the surface, {ratio:.3g} times what "
            f"landmarks and probe explain (limit {MAX_START_RATIO:g}); check that the mesh is this patient's, its unit "
            "and its directions."
        )
        raise RefusalError("surface_far", text, median=median, ratio=ratio, limit=MAX_START_RATIO)


def check_curvature(normals: Floats) -> None:
    """Raise an error if the unit normals of the points, (K, 3), nearly agree."""
    second = float(np.linalg.eigvalsh(normals.T @ normals / len(normals))[1])
    if second < MIN_CURVATURE:
        text = (
            f"The touched points lie on one flat patch (spread of the normals {second:.2g}, limit {MIN_CURVATURE:g}), "
            "along which the surface slides; touch other sides, too."
        )
        raise RefusalError("surface_flat", text, spread=second, limit=MIN_CURVATURE)


def check_step(motion: Transform, covariance: Floats) -> None:
    """Raise an error if the refinement contradicts the landmarks.

    Args:
        motion: Motion from the landmarks' registration to the refined one, in body_ref.
        covariance: Covariance of the landmarks' registration, rad and m, (6, 6).
    """
    step = np.concatenate((motion.rotvec, motion.translation))
    squared = float(step @ np.linalg.solve(covariance, step))
    if squared > MAX_STEP:
        text = (
            f"The surface moves the registration {math.sqrt(squared):.3g} deviations of the landmarks, limit "
            f"{math.sqrt(MAX_STEP):.3g}: one of both is wrong; digitize the landmarks again."
        )
        raise RefusalError("surface_step_too_large", text, step=squared, limit=MAX_STEP)


def check_offset(region: str, value: float, deviation: float, limit: float) -> None:
    """Raise an error if the touched points of a region have an offset that neither hair nor a light hand explains.

    Args:
        region: Region of the points.
        value: Estimated offset, outwards, m.
        deviation: Standard deviation of `value`, m.
        limit: Largest plausible offset in either direction, m.
    """
    if not abs(value) <= limit:
        place = {"hair": "in the hair", "face": "on the face"}.get(region, "of the surface")
        side = "outside" if value > 0.0 else "inside"
        text = (
            f"The touched points {place} are {abs(value) * 1000:.3g} ± {deviation * 1000:.2g} mm {side} the mesh, "
            f"limit {limit * 1000:.3g} mm; check the mesh, part the hair, and touch again."
        )
        fields = {"region": region, "offset": value, "deviation": deviation, "limit": limit}
        raise RefusalError("surface_offset_too_large", text, **fields)


def check_fit(rms: float, explained: float) -> None:
    """Raise an error if the points do not fit the surface at its best place.

    Args:
        rms: Rms distance of the inliers from the surface, m.
        explained: Rms distance that noise and trimming explain, m.
    """
    limit = MAX_MISFIT * explained
    if rms > limit:
        text = (
            f"The touched points are {rms * 1000:.3g} mm (rms) from the surface at its best place, limit "
            f"{limit * 1000:.3g} mm; check the mesh, or touch again without pressing."
        )
        raise RefusalError("surface_misfit", text, rms=rms, limit=limit)


def check_gain(before: float, after: float) -> None:
    """Raise an error if the refinement does not lower the predicted TRE.

    Args:
        before: Predicted rms TRE with the landmarks alone, m.
        after: Predicted rms TRE with landmarks and surface, m.
    """
    if not after <= (1.0 - MIN_GAIN) * before:
        text = (
            f"With the surface the predicted TRE is {after * 1000:.3g} mm, without {before * 1000:.3g} mm: not "
            f"{MIN_GAIN:.0%} less; touch points nearer to the target, or keep the landmarks' registration."
        )
        raise RefusalError("tre_not_lowered", text, tre_before=before, tre_after=after, gain=MIN_GAIN)
