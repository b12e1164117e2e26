"""Plans from messages of Slicer: checked as a whole and converted from mm to m, or refused with the reason."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from pcmrs.devices.plus.messages import rigid
from pcmrs.errors import RefusalError

NEAREST_MM = 1.0
"""Limit of a target's distance to the image's origin, mm: a nearer one is in m by mistake, or a new transform."""
FARTHEST_MM = 1000.0
SMALLEST_MM = 5.0
"""Limit of the extent of all landmarks, mm: smaller ones are in m by mistake."""
FEWEST, MOST = 3, 100


def target(matrix_mm: npt.ArrayLike) -> dict[str, Any]:
    """Return the arguments of ``toolplan.plan`` from the matrix (4, 4), mm, of the planned tool in the image.

    Raises:
        RefusalError: The matrix is not a rigid transform, or cannot be in mm.
    """
    image_from_coil = rigid(matrix_mm)
    _check_near(image_from_coil.translation * 1e3)
    distance_mm = float(np.linalg.norm(image_from_coil.translation)) * 1e3
    if distance_mm < NEAREST_MM:
        text = f"The target is {distance_mm:.3g} mm from the image's origin, the limit is {NEAREST_MM:g} mm. "
        text += "Is it a new, empty transform, or in metres? OpenIGTLink has millimetres."
        raise RefusalError("wrong_unit", text, value=distance_mm, limit=NEAREST_MM)
    return {"position": image_from_coil.translation.tolist(), "quat_xyzw": image_from_coil.quat_xyzw.tolist()}


def landmarks(positions_mm: Sequence[Sequence[float]], names: Sequence[str]) -> dict[str, Any]:
    """Return the arguments of ``registration.plan_landmarks``.

    Args:
        positions_mm: Points in the image, mm, (n, 3).
        names: Their names; a point with an empty name gets one.

    Raises:
        RefusalError: There are too few or too many points, a number is not finite, or they cannot be in mm.
    """
    if not FEWEST <= len(positions_mm) <= MOST:
        text = f"{len(positions_mm)} points were sent; a plan has {FEWEST} to {MOST} landmarks."
        raise RefusalError("wrong_count", text, count=len(positions_mm), fewest=FEWEST, most=MOST)
    points = np.array(positions_mm, dtype=float)
    if not np.isfinite(points).all():
        raise RefusalError("not_finite", "A landmark holds a number that is not finite; place it again.")
    _check_near(points)
    extent_mm = float(np.linalg.norm(np.ptp(points, axis=0)))
    if extent_mm < SMALLEST_MM:
        text = f"All landmarks lie within {extent_mm:.3g} mm, the limit is {SMALLEST_MM:g} mm. "
        text += "Are they in metres? OpenIGTLink has millimetres."
        raise RefusalError("wrong_unit", text, value=extent_mm, limit=SMALLEST_MM)
    named = zip(names, (points * 1e-3).tolist(), strict=True)
    return {"landmarks": [{"name": name or f"p{i}", "position": point} for i, (name, point) in enumerate(named)]}


def _check_near(points_mm: npt.NDArray[np.float64]) -> None:
    farthest_mm = float(np.abs(points_mm).max())
    if farthest_mm > FARTHEST_MM:
        text = f"A coordinate is {farthest_mm:.6g} mm from the image's origin, the limit is {FARTHEST_MM:g} mm."
        raise RefusalError("wrong_unit", text, value=farthest_mm, limit=FARTHEST_MM)
