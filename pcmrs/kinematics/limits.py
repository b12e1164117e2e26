"""Joint values as checked arrays, and the limits of the arm's motion."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import isfinite

import numpy as np
import numpy.typing as npt

from pcmrs.errors import ConfigurationError, GeometryError
from pcmrs.spatial import Floats


def joint_array(values: npt.ArrayLike, joints: int) -> Floats:
    """Return a copy of joint values as an array, (n,).

    Args:
        values: One finite number per joint.
        joints: Number n of joints of the arm.

    Raises:
        GeometryError: The values are not that many finite numbers.
    """
    array = np.array(values, dtype=float)
    if array.shape != (joints,) or not all(map(isfinite, array.tolist())):
        raise GeometryError(
            f"Joint values are {joints} finite numbers, not {array.tolist()}; send one for each joint.",
            values=array.tolist(),
            joints=joints,
        )
    return array


@dataclass(frozen=True)
class MotionLimits:
    """Greatest speeds, accelerations and jerks of the joints and of the tool.

    Attributes:
        joint_velocity: Speed of each joint, rad/s, (n,).
        joint_acceleration: Acceleration of each joint, rad/s^2, (n,).
        joint_jerk: Jerk of each joint, rad/s^3, (n,).
        linear_velocity: Speed of the tool point, m/s.
        linear_acceleration: Acceleration of the tool point, m/s^2.
        linear_jerk: Jerk of the tool point, m/s^3.
        angular_velocity: Angular speed of the tool, rad/s.
        angular_acceleration: Angular acceleration of the tool, rad/s^2.

    Raises:
        ConfigurationError: A limit is not positive and finite, or is not given for every joint.
    """

    joint_velocity: tuple[float, ...]
    joint_acceleration: tuple[float, ...]
    joint_jerk: tuple[float, ...]
    linear_velocity: float
    linear_acceleration: float
    linear_jerk: float
    angular_velocity: float
    angular_acceleration: float

    def __post_init__(self) -> None:
        joints = max(len(self.joint_velocity), len(self.joint_acceleration), len(self.joint_jerk))
        for field in fields(self):
            values = np.asarray(getattr(self, field.name), dtype=float)
            shape = (joints,) if field.name.startswith("joint_") else ()
            if values.shape != shape or not np.all(np.isfinite(values) & (values > 0.0)):
                count = f"{joints} positive numbers" if shape else "one positive number"
                raise ConfigurationError(
                    f"The motion limit {field.name} is {values.tolist()}, must be {count}.",
                    limit=field.name,
                    value=values.tolist(),
                )
