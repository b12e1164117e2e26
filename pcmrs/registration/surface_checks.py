"""When a surface does not help a registration, and what to do then: every refusal of `refine_with_surface`."""

from __future__ import annotations

import math

import numpy as np

from pcmrs.errors import RefusalError
from pcmrs.spatial import Floats, Transform

MIN_POINTS = 20
"""Of the surface: three times the freedoms of a rigid motion, after trimming."""
FAR = 4.0
"""Median distance of the points from the surface, in deviations that landmarks and probe explain; 0.7 to 2 is usual."""
MIN_CURVATURE = 0.03
"""Second eigenvalue of the mean of n nᵀ: normals within about 20° of one direction are one flat patch."""
MAX_STEP = 22.46
"""99.9 % of chi-square with 6 degrees of freedom: how far, squared, the landmarks let the solution be moved."""
MAX_MISFIT = 2.0
"""Rms distance of the inliers, in what `sigma_surface` and the trimming explain."""
MIN_GAIN = 0.02
"""Part of the TRE that a refinement must take away; below that, it is not worth leaving the landmarks alone."""


def check_count(touched: int, believed: int) -> None:
    """Refuses so few points that six freedoms would fit to their noise."""
    if believed < MIN_POINTS:
        text = (
            f"{touched} points of the surface leave {believed} after trimming, at least {MIN_POINTS} are needed; "
            "touch more."
        )
        raise RefusalError("too_few_surface_points", text, count=believed, limit=MIN_POINTS)


def check_near(distances: Floats, deviations: Floats) -> None:
    """Refuses a start from which nearest points mean nothing: another mesh, its unit or its directions.

    Args:
        distances: Of the touched points from the surface, m, (K,).
        deviations: That landmarks and probe explain, m, (K,).
    """
    ratio, median = float(np.median(distances / deviations)), float(np.median(distances))
    if not ratio <= FAR:
        text = (
            f"Half of the touched points are {median * 1000:.4g} mm or more from the surface, {ratio:.3g} times what "
            f"landmarks and probe explain (limit {FAR:g}); check that the mesh is this patient's, its unit and its "
            "directions."
        )
        raise RefusalError("surface_far", text, median=median, ratio=ratio, limit=FAR)


def check_curvature(normals: Floats) -> None:
    """Refuses points whose unit normals (K, 3) all but agree."""
    second = float(np.linalg.eigvalsh(normals.T @ normals / len(normals))[1])
    if second < MIN_CURVATURE:
        text = (
            f"The touched points lie on one flat patch (spread of the normals {second:.2g}, limit {MIN_CURVATURE:g}), "
            "along which the surface slides; touch other sides, too."
        )
        raise RefusalError("surface_flat", text, spread=second, limit=MIN_CURVATURE)


def check_step(motion: Transform, covariance: Floats) -> None:
    """Refuses a refinement that the landmarks contradict.

    Args:
        motion: From the landmarks' registration to the refined one, in body_ref.
        covariance: Of the landmarks' registration, rad and m, (6, 6).
    """
    step = np.concatenate((motion.rotvec, motion.translation))
    squared = float(step @ np.linalg.solve(covariance, step))
    if squared > MAX_STEP:
        text = (
            f"The surface moves the registration {math.sqrt(squared):.3g} deviations of the landmarks, limit "
            f"{math.sqrt(MAX_STEP):.3g}: one of both is wrong; digitize the landmarks again."
        )
        raise RefusalError("surface_step_too_large", text, step=squared, limit=MAX_STEP)


def check_fit(rms: float, explained: float) -> None:
    """Refuses a surface that the points do not fit at its best place; both rms, m."""
    limit = MAX_MISFIT * explained
    if rms > limit:
        text = (
            f"The touched points are {rms * 1000:.3g} mm (rms) from the surface at its best place, limit "
            f"{limit * 1000:.3g} mm; check the mesh, or touch again without pressing."
        )
        raise RefusalError("surface_misfit", text, rms=rms, limit=limit)


def check_gain(before: float, after: float) -> None:
    """Refuses a refinement that does not lower the predicted TRE, m."""
    if not after <= (1.0 - MIN_GAIN) * before:
        text = (
            f"With the surface the predicted TRE is {after * 1000:.3g} mm, without {before * 1000:.3g} mm: not "
            f"{MIN_GAIN:.0%} less; touch points nearer to the target, or keep the landmarks' registration."
        )
        raise RefusalError("tre_not_lowered", text, tre_before=before, tre_after=after, gain=MIN_GAIN)
