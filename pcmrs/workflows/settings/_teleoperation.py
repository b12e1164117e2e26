"""Settings of teleoperation: speeds and bounds of a guided tool, and limits of the delay."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.workflows.settings._values import Length, Positive


class TeleoperationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of a tool that a teleoperator guides. Times are those of the cell.

    Attributes:
        period: Time between two set points of the joints, s.
        deadman: Time without a fresh set point of the teleoperator after which the robot is held and latched, s.
        linear_velocity: Greatest speed of the tool, m/s.
        angular_velocity: Greatest angular speed of the tool, rad/s.
        linear_acceleration: Greatest acceleration of the tool, m/s^2.
        angular_acceleration: Greatest angular acceleration of the tool, rad/s^2.
        range: Largest distance of the tool point from its planned place, m; more than `placement.standoff`.
        turn_deg: Largest angle of the tool to its planned pose, deg.
        slow_delay: Sum of round trip and jitter above which the tool is slowed, s.
        longest_delay: Sum of round trip and jitter at which the tool stops until the teleoperator has released the
            controls once, s.

    Raises:
        ValueError: `longest_delay` is not beyond `slow_delay`.
    """

    period: Annotated[float, msgspec.Meta(gt=0.0, le=0.016)] = 0.010
    deadman: Annotated[float, msgspec.Meta(ge=0.05, le=0.5)] = 0.1
    linear_velocity: Positive = 0.02
    angular_velocity: Positive = 0.2
    linear_acceleration: Positive = 0.2
    angular_acceleration: Positive = 2.0
    range: Length = 0.12
    turn_deg: Annotated[float, msgspec.Meta(gt=0.0, le=90.0)] = 30.0
    slow_delay: Positive = 0.15
    longest_delay: Positive = 0.5

    def __post_init__(self) -> None:
        if not self.longest_delay > self.slow_delay:
            raise ValueError(f"longest_delay is {self.longest_delay:g} s, but slow_delay is {self.slow_delay:g} s")
