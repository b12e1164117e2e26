"""Set points of teleoperators from the bus into the cell, and what they are told out of it."""

from __future__ import annotations

from pcmrs.devices.link import Link
from pcmrs.messages import TeleopSetpoint
from pcmrs.workflows.teleop_port import TeleopPort

SETPOINTS, STATUS = "teleop/*", "state/teleop"


def connect_teleoperators(link: Link, port: TeleopPort) -> None:
    """Hands on what comes by whoever the key names: access control lets nobody use another's key."""

    def take(key: str, setpoint: TeleopSetpoint) -> None:
        port.take(key.partition("/")[2], setpoint)

    port.tell = lambda status: link.publish(STATUS, status)
    link.subscribe(SETPOINTS, TeleopSetpoint, take)
