"""Where the set points of teleoperators come in, and what the daemon tells them goes out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from pcmrs.messages import TeleopSetpoint, TeleopStatus

Hear = Callable[[str, TeleopSetpoint], None]


def nobody_hears(_user: str, _setpoint: TeleopSetpoint) -> None:
    """Set points have no effect while nobody guides the tool."""


def nobody_is_told(_status: TeleopStatus) -> None:
    """A cell without a bus tells nobody."""


@dataclass
class TeleopPort:
    """Between the bus and the activity that guides the tool.

    Attributes:
        take: Takes a user's set point the moment it comes.
        tell: Publishes a status.
    """

    take: Hear = nobody_hears
    tell: Callable[[TeleopStatus], None] = nobody_is_told

    @contextmanager
    def heard_by(self, hear: Hear) -> Iterator[None]:
        """Has set points heard for as long as the context lasts."""
        self.take = hear
        try:
            yield
        finally:
            self.take = nobody_hears
