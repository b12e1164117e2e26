"""Whether coordinates can be in m."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pcmrs.errors import RefusalError

FARTHEST = 1.0
"""A coordinate farther than this from the origin of the image (m) was probably given in mm."""


def check_metres(points: npt.ArrayLike) -> None:
    """Refuses coordinates in the image that are too large to be in m, (..., 3). Raises `RefusalError`."""
    farthest = float(np.abs(points).max())
    if farthest > FARTHEST:
        text = f"A coordinate is {farthest:g} m; the limit is {FARTHEST:g} m. Were these millimetres?"
        raise RefusalError("wrong_unit", text, value=farthest, limit=FARTHEST)
