"""Kinds of numbers, and a pose, as they are configured."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.errors import GeometryError
from pcmrs.spatial import Transform

NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Triple = tuple[float, float, float]


class PoseSetting(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``a_from_b`` as configured: translation in m and unit quaternion.

    Raises:
        ValueError: It is no pose.
    """

    position: Triple = (0.0, 0.0, 0.0)
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        try:
            self.transform()
        except GeometryError as error:
            raise ValueError(error.text) from None  # to which msgspec adds the key

    def transform(self) -> Transform:
        """The same as a `Transform`."""
        return Transform.from_quat_wxyz(self.position, self.quat_wxyz)
