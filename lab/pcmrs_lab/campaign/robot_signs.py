"""What a client of a cell receives of a robot while something is wrong with it, or does not."""

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
"""A robot that has sent no joints for so long is silent, s of the machine; it sends 50 a second or more."""

ALARMS = {
    "e_stop": "drives_off",
    "offset_joint": "pose_differs",
    "change_mode": "drives_off",
    "close_brakes": "drives_off",
    "push_tool": "force_limit",
    "drop_client": "link_lost",
}
"""By the fault's name: code of the event by which the robot says so itself; one whose link is silent says nothing."""


class RobotHeard:
    """Events of the robot, and when the last joints came."""

    def __init__(self) -> None:
        self._clock = SystemClock()
        self._last = self._clock.monotonic()
        self.codes: list[str] = []

    def take(self, event: DeviceEvent) -> None:
        """Puts an event to the others."""
        self.codes.append(event.code)

    def see(self, _: JointState) -> None:
        """Joints have come."""
        self._last = self._clock.monotonic()

    @property
    def silence(self) -> float:
        """For how long no joints have come, s of the machine."""
        return self._clock.monotonic() - self._last

    def shown(self, name: str) -> dict[str, Any]:
        """Details of how a fault was seen.

        Raises:
            Unmet: It was not.
        """
        if name in ALARMS:
            measured: dict[str, Any] = {f"events {ALARMS[name]}": self.codes.count(ALARMS[name])}
        else:
            measured = {"no joints for_s": self.silence if self.silence > SILENCE else 0.0}
        if not all(measured.values()):
            raise Unmet(f"No client has seen '{name}': {measured}; events: {self.codes}.")
        return measured


@asynccontextmanager
async def robot_heard(cell: RunningCell) -> AsyncIterator[RobotHeard]:
    """What a client of the cell receives of the robot during the context."""
    found = RobotHeard()
    ends = (
        cell.client.listen("dev/robot/event", DeviceEvent, found.take),
        cell.client.listen("state/joints", JointState, found.see),
    )
    try:
        yield found
    finally:
        for end in ends:
            await end()
