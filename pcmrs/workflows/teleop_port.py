"""Port between the bus and teleoperation: it receives set points and publishes statuses."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from pcmrs.messages import TeleopSetpoint, TeleopStatus

SetpointHandler = Callable[[str, TeleopSetpoint], None]


def _discard_setpoint(_user: str, _setpoint: TeleopSetpoint) -> None:
    """Discard a set point, because nobody guides the tool."""


def _discard_status(_status: TeleopStatus) -> None:
    """Discard a status, because the cell has no bus."""


@dataclass
class TeleopPort:
    """Port between the bus and the activity that guides the tool.

    Attributes:
        receive: Function that takes a user's set point as soon as it arrives.
        publish: Function that publishes a status.
    """

    receive: SetpointHandler = _discard_setpoint
    publish: Callable[[TeleopStatus], None] = _discard_status

    @contextmanager
    def deliver_to(self, handler: SetpointHandler) -> Iterator[None]:
        """Deliver set points to a handler for as long as the context lasts."""
        self.receive = handler
        try:
            yield
        finally:
            self.receive = _discard_setpoint
