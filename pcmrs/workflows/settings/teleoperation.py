"""How a teleoperator guides the tool, and when that is slowed and ended."""

from __future__ import annotations

from typing import Annotated

import msgspec

from pcmrs.workflows.settings.values import Positive


class TeleoperationSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What set points of a teleoperator may do; times are of the cell.

    Attributes:
        period: Between two set points of the joints, s.
        deadman: Without a fresh set point of the teleoperator for so long the robot is held and latched, s.
        linear_velocity: Of the tool at most, m/s.
        angular_velocity: The same for its rotation, rad/s.
        linear_acceleration: Of the tool at most, m/s^2.
        angular_acceleration: The same for its rotation, rad/s^2.
        range: The tool point may be so far from its planned place, m; more than `placement.standoff`.
        turn_deg: The tool may be turned so much against its planned pose.
        slow_delay: Round trip and jitter together from which on the tool is slower, s.
        longest_delay: The same at which it stands, until the teleoperator has let go once, s.

    Raises:
        ValueError: `longest_delay` is not beyond `slow_delay`.
    """

    period: Annotated[float, msgspec.Meta(gt=0.0, le=0.016)] = 0.010
    deadman: Annotated[float, msgspec.Meta(ge=0.05, le=0.5)] = 0.1
    linear_velocity: Positive = 0.02
    angular_velocity: Positive = 0.2
    linear_acceleration: Positive = 0.2
    angular_acceleration: Positive = 2.0
    range: Positive = 0.12
    turn_deg: Annotated[float, msgspec.Meta(gt=0.0, le=90.0)] = 30.0
    slow_delay: Positive = 0.15
    longest_delay: Positive = 0.5

    def __post_init__(self) -> None:
        if not self.longest_delay > self.slow_delay:
            raise ValueError(f"longest_delay is {self.longest_delay:g} s, but slow_delay is {self.slow_delay:g} s")
