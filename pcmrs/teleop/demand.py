"""The demand of a teleoperator at a moment, and the conversion of deflections to velocities. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from pcmrs.messages.teleop import AT_REST, Twist


@dataclass(frozen=True, slots=True)
class Demand:
    """Demand of the teleoperator at a moment.

    Attributes:
        twist: Velocity along and about the tool's axes, m/s and rad/s; +z points away from the body.
        clutch: The clutch is held: nothing moves without it.
        stop: Stop was pressed.
        leave: The teleoperator ends the session.
    """

    twist: Twist = AT_REST
    clutch: bool = False
    stop: bool = False
    leave: bool = False


class InputDevice(Protocol):
    """A device that hands move, or a script in its place."""

    def demand(self, now: float) -> Demand:
        """Return the present demand without waiting; `now` in s of the monotonic clock, never decreasing."""


@dataclass(frozen=True, slots=True)
class Mapping:
    """Conversion of a device's deflections to a twist.

    Attributes:
        linear: Velocity at full deflection, m/s.
        angular: Angular velocity at full deflection, rad/s.
        dead_zone: Deflection that an untouched device may have, as a part of the full one.
    """

    linear: float = 0.01
    angular: float = 0.1
    dead_zone: float = 0.1

    def twist(self, deflection: Sequence[float]) -> Twist:
        """Return the twist for deflections along x, y, z and about x, y, z, -1 to 1 each."""
        x, y, z, rx, ry, rz = (self._beyond_dead_zone(each) for each in deflection)
        return (
            *(each * self.linear for each in (x, y, z)),
            *(each * self.angular for each in (rx, ry, rz)),
        )  # type: ignore[return-value]

    def _beyond_dead_zone(self, value: float) -> float:
        """Return 0 in the dead zone, and from its edge a value that rises without a step to 1."""
        length = min(abs(value), 1.0) - self.dead_zone
        return 0.0 if length <= 0.0 else (length if value > 0.0 else -length) / (1.0 - self.dead_zone)
