"""Where the set points of teleoperators come in, and what the daemon tells them goes out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from pcmrs.messages import TeleopSetpoint, TeleopStatus

SetpointHandler = Callable[[str, TeleopSetpoint], None]


def _discard_setpoint(_user: str, _setpoint: TeleopSetpoint) -> None:
    """Set points have no effect while nobody guides the tool."""


def _discard_status(_status: TeleopStatus) -> None:
    """A cell without a bus tells nobody."""


@dataclass
class TeleopPort:
    """Between the bus and the activity that guides the tool.

    Attributes:
        receive: Takes a user's set point the moment it comes.
        publish: Publishes a status.
    """

    receive: SetpointHandler = _discard_setpoint
    publish: Callable[[TeleopStatus], None] = _discard_status

    @contextmanager
    def deliver_to(self, handler: SetpointHandler) -> Iterator[None]:
        """Has set points heard for as long as the context lasts."""
        self.receive = handler
        try:
            yield
        finally:
            self.receive = _discard_setpoint
