"""Joint values as arrays."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError
from pcmrs.spatial import Floats

JOINTS = 7


def joint_array(values: npt.ArrayLike) -> Floats:
    """A copy of one value per joint, (7,).

    Raises:
        GeometryError: They are not seven finite numbers.
    """
    array = np.array(values, dtype=float)
    if array.shape != (JOINTS,) or not np.isfinite(array).all():
        raise GeometryError(
            f"Joint values are {JOINTS} finite numbers, not {array.tolist()}; send one for each joint.",
            values=array.tolist(),
        )
    return array
