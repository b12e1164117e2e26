"""Observations of a client of a cell while the robot has a fault."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

from pcmrs.clock import SystemClock
from pcmrs.messages import DeviceEvent, JointState
from pcmrs.testing.errors import Unmet

if TYPE_CHECKING:
    from pcmrs.testing.cell import RunningCell

SILENCE = 0.6
"""Time without joints after which a robot counts as silent, s of the machine; it sends 50 a second or more."""

ALARMS = {
    "e_stop": "drives_off",
    "offset_joint": "pose_differs",
    "change_mode": "drives_off",
    "close_brakes": "drives_off",
    "push_tool": "force_limit",
    "drop_client": "link_lost",
}
"""Code of the event by which the robot reports a fault, by the fault's name; a robot whose link is silent reports
nothing."""


class RobotReports:
    """Events of the robot, and the time of the last joints."""

    def __init__(self) -> None:
        self._clock = SystemClock()
        self._last = self._clock.monotonic()
        self.codes: list[str] = []

    def take(self, event: DeviceEvent) -> None:
        """Record an event."""
        self.codes.append(event.code)

    def take_joints(self, _: JointState) -> None:
        """Record that joints have come."""
        self._last = self._clock.monotonic()

    @property
    def silence(self) -> float:
        """Time since the last joints, s of the machine."""
        return self._clock.monotonic() - self._last

    def shown(self, name: str) -> dict[str, Any]:
        """Return details of how a fault was observed.

        Raises:
            Unmet: It was not observed.
        """
        if name in ALARMS:
            measured: dict[str, Any] = {f"events {ALARMS[name]}": self.codes.count(ALARMS[name])}
        else:
            measured = {"no joints for_s": self.silence if self.silence > SILENCE else 0.0}
        if not all(measured.values()):
            raise Unmet(f"No client has seen '{name}': {measured}; events: {self.codes}.")
        return measured


@asynccontextmanager
async def robot_reports(cell: RunningCell) -> AsyncIterator[RobotReports]:
    """Collect the reports of the robot that a client receives during the context."""
    found = RobotReports()
    ends = (
        cell.client.listen("dev/robot/event", DeviceEvent, found.take),
        cell.client.listen("state/joints", JointState, found.take_joints),
    )
    try:
        yield found
    finally:
        for end in ends:
            await end()
