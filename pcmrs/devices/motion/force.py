"""What an arm knows of the force on its flange, and when that is too much."""

from __future__ import annotations

from typing import Annotated, Protocol

import msgspec

from pcmrs.spatial import Floats

AGAIN = 5.0
"""A force that has exceeded the limit counts again when it has grown, or first fallen below the limit, by this, N.

Half the limit is enough to fall by, where that is less.
"""


class FlangeForce(Protocol):
    """An arm's estimate of the external force on what its flange carries."""

    @property
    def axis(self) -> Floats:
        """The tool's +z, along which contact pushes, in the flange's axes, (3,)."""

    @property
    def flange_force(self) -> tuple[float, float, float]:
        """N, along the flange's axes."""

    @property
    def magnitude(self) -> float:
        """Of the force, N."""


class ForceSettings(msgspec.Struct, frozen=True):
    """What drivers read of the table ``robot``: when the arm stops by itself.

    Attributes:
        force_limit: The greatest force, N.
        relief_mm: The way by which it is relieved.
        deadman: A servo session ends so long after its last set point, s of the cell.
    """

    force_limit: Annotated[float, msgspec.Meta(gt=0.0)] = 25.0
    relief_mm: Annotated[float, msgspec.Meta(ge=0.0, le=5.0)] = 0.0
    deadman: Annotated[float, msgspec.Meta(ge=0.05, le=1.0)] = 0.1


class ForceGuard:
    """Says once when a force exceeds its limit, so that the arm may still be moved out of it.

    Args:
        limit: N.
    """

    def __init__(self, limit: float) -> None:
        self.limit = self._threshold = limit

    def exceeded(self, force: float) -> bool:
        """Whether the limit is exceeded anew."""
        if force < max(self.limit - AGAIN, self.limit / 2.0):
            self._threshold = self.limit
        if force <= self._threshold:
            return False
        self._threshold = force + AGAIN
        return True
