"""Units and directions that files declare, and what they are in RAS and m."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from pcmrs.spatial import Floats

Unit = Literal["m", "mm"]
Space = Literal["RAS", "LPS"]
Role = Literal["planned", "digitized"]
Named = tuple[str, tuple[float, ...]]
"""A name and its point, RAS, m."""

METRES = {"m": 1.0, "mm": 1e-3, "um": 1e-6}
RAS_FROM = {"RAS": (1.0, 1.0, 1.0), "LPS": (-1.0, -1.0, 1.0)}


def as_ras(points: npt.ArrayLike, unit: str, space: str) -> Floats:
    """Points (3,) or (N, 3) in `unit` and `space` as RAS and m.

    The way from LPS (DICOM PS3.3 C.7.6.2.1.1) is half a turn about the superior axis: handedness stays.
    """
    converted: Floats = np.asarray(points, dtype=float) * METRES[unit] * np.array(RAS_FROM[space])
    return converted
