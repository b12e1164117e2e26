"""Types of numbers and poses in the configuration."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.errors import GeometryError
from pcmrs.spatial import Transform

NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Length = Annotated[float, msgspec.Meta(gt=0.0, le=5.0, extra={"unit": "m"})]
"""A length in a cell, m. The limit is that of a room: a larger number was meant in mm."""
LengthOrZero = Annotated[float, msgspec.Meta(ge=0.0, le=5.0, extra={"unit": "m"})]
Triple = tuple[float, float, float]


class PoseSetting(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A configured pose ``a_from_b``.

    Attributes:
        position: Translation, m.
        quat_wxyz: Unit quaternion w x y z.

    Raises:
        ValueError: It is not a valid pose.
    """

    position: Triple = (0.0, 0.0, 0.0)
    quat_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        try:
            self.transform()
        except GeometryError as error:
            raise ValueError(error.text) from None  # msgspec adds the key to this text

    def transform(self) -> Transform:
        """Return this pose as a `Transform`."""
        return Transform.from_quat_wxyz(self.position, self.quat_wxyz)


class WholePoseSetting(PoseSetting, frozen=True, forbid_unknown_fields=True):
    """A configured pose of which both parts must be given: axes that are left out would be taken for the same axes.

    Attributes:
        position: Translation, m.
        quat_wxyz: Unit quaternion w x y z.
    """

    position: Triple
    quat_wxyz: tuple[float, float, float, float]
