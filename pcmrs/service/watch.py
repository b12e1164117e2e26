"""The daemon's heartbeat for the robot's node, and what it means when the robot falls silent."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from pcmrs.clock import Clock
from pcmrs.devices.node import DAEMON_BEAT
from pcmrs.messages import Beat, DeviceEvent

PERIOD = 0.05
"""Seconds of the machine between beats."""

SILENCE = 1.0
"""A robot whose joints have not been heard for so long is lost, s of the machine."""


class RobotWatch:
    """Beats for the robot's node and listens for the robot's joints.

    Args:
        publish: `Bus.publish`.
        connected: Whether the workflow holds the robot for connected.
        in_doubt: Whether a stopped robot has not confirmed that it stands: it is then left without beats, so
            that its node holds it by itself, too.
        report: `Dispatcher.report`.
        clock: The machine's clock.
    """

    def __init__(
        self,
        publish: Callable[[str, Beat], None],
        connected: Callable[[], bool],
        in_doubt: Callable[[], bool],
        report: Callable[[DeviceEvent], Awaitable[None]],
        clock: Clock,
    ) -> None:
        self._publish = publish
        self._connected = connected
        self._in_doubt = in_doubt
        self._report = report
        self._clock = clock
        self._heard = clock.monotonic()

    async def run(self) -> None:
        """Beats and watches until cancelled.

        While a loss is being dealt with it does not beat: the node then holds the robot by itself, too.
        """
        number = 0
        while True:
            number += 1
            if not self._in_doubt():
                self._publish(DAEMON_BEAT, Beat(number=number))
            silence = self._clock.monotonic() - self._heard
            if silence > SILENCE and self._connected():
                await self.lose(f"The robot has not reported its joints for {silence:.1f} s.")
            await self._clock.sleep(PERIOD)

    async def lose(self, text: str) -> None:
        """Reports the link to the robot as lost: motion is held, the robot counts as disconnected."""
        if self._connected():
            await self._report(DeviceEvent(device="robot", code="link_lost", text=text, danger=True))

    def hear(self) -> None:
        """The robot has reported its joints."""
        self._heard = self._clock.monotonic()
