"""Joint values as arrays."""

from __future__ import annotations

from math import isfinite

import numpy as np
import numpy.typing as npt

from pcmrs.errors import GeometryError
from pcmrs.spatial import Floats


def joint_array(values: npt.ArrayLike, joints: int) -> Floats:
    """A copy of one value per joint, (n,) for an arm of n = `joints` joints.

    Raises:
        GeometryError: They are not that many finite numbers.
    """
    array = np.array(values, dtype=float)
    if array.shape != (joints,) or not all(map(isfinite, array.tolist())):
        raise GeometryError(
            f"Joint values are {joints} finite numbers, not {array.tolist()}; send one for each joint.",
            values=array.tolist(),
            joints=joints,
        )
    return array
