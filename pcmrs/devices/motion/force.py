"""Force on the flange of an arm, and the guard that limits it."""

from __future__ import annotations

from typing import Annotated, Protocol

import msgspec

from pcmrs.spatial import Floats

HYSTERESIS = 5.0
"""Hysteresis of the guard, N.

A force that has exceeded the limit counts again when it has grown by this, or when it has first fallen by this below
the limit; half the limit is enough if that is less.
"""


class FlangeForce(Protocol):
    """An arm's estimate of the external force on what its flange carries."""

    @property
    def axis(self) -> Floats:
        """Unit vector of the tool's +z, along which contact pushes, in the flange's axes, (3,)."""

    @property
    def flange_force(self) -> tuple[float, float, float]:
        """External force along the flange's axes, N."""

    @property
    def magnitude(self) -> float:
        """Magnitude of the force, N."""


class ForceSettings(msgspec.Struct, frozen=True):
    """Values of the table ``robot`` that drivers read: when the arm stops by itself.

    Attributes:
        force_limit: Greatest force on the tool, N.
        relief_mm: Travel by which a greater force is relieved, mm.
        deadman: Time after the last set point at which a servo session ends, s of the cell.
    """

    force_limit: Annotated[float, msgspec.Meta(gt=0.0)] = 25.0
    relief_mm: Annotated[float, msgspec.Meta(ge=0.0, le=5.0)] = 0.0
    deadman: Annotated[float, msgspec.Meta(ge=0.05, le=1.0)] = 0.1


class ForceGuard:
    """Guard that reports once that a force exceeds its limit, so that the arm can still be moved away.

    Args:
        limit: Greatest force, N.

    Attributes:
        limit: As above.
    """

    def __init__(self, limit: float) -> None:
        self.limit = self._threshold = limit
        self._normal = max(limit - HYSTERESIS, limit / 2.0)

    def exceeded(self, force: float) -> bool:
        """Return True if `force`, N, exceeds the limit and was not reported before."""
        if force < self._normal:
            self._threshold = self.limit
        if force <= self._threshold:
            return False
        self._threshold = force + HYSTERESIS
        return True
