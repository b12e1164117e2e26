"""Set points of teleoperators from the bus into the cell, and their status back."""

from __future__ import annotations

from collections.abc import Callable

from pcmrs.devices.link import Link
from pcmrs.messages import TeleopSetpoint, TeleopStatus
from pcmrs.workflows.teleop_port import TeleopPort

SETPOINTS, STATUS = "teleop/*", "state/teleop"


def connect_teleoperators(link: Link, port: TeleopPort, seen: Callable[[], None]) -> None:
    """Forward set points of the user that the key names: access control prevents the use of another's key.

    Args:
        link: Link to the bus.
        port: Port of the cell.
        seen: Called while a person's hands guide the tool.
    """

    def take(key: str, setpoint: TeleopSetpoint) -> None:
        port.receive(key.partition("/")[2], setpoint)

    def publish(status: TeleopStatus) -> None:
        link.publish(STATUS, status)
        if status.sequence:
            seen()

    port.publish = publish
    link.subscribe(SETPOINTS, TeleopSetpoint, take)
