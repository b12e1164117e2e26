"""Set points of teleoperators from the bus into the cell, and what they are told out of it."""

from __future__ import annotations

from collections.abc import Callable

from pcmrs.devices.link import Link
from pcmrs.messages import TeleopSetpoint, TeleopStatus
from pcmrs.workflows.teleop_port import TeleopPort

SETPOINTS, STATUS = "teleop/*", "state/teleop"


def connect_teleoperators(link: Link, port: TeleopPort, seen: Callable[[], None]) -> None:
    """Hands on what comes by whoever the key names: access control lets nobody use another's key.

    Args:
        link: To the bus.
        port: Of the cell.
        seen: Called while somebody's hands guide the tool.
    """

    def take(key: str, setpoint: TeleopSetpoint) -> None:
        port.receive(key.partition("/")[2], setpoint)

    def publish(status: TeleopStatus) -> None:
        link.publish(STATUS, status)
        if status.sequence:
            seen()

    port.publish = publish
    link.subscribe(SETPOINTS, TeleopSetpoint, take)
