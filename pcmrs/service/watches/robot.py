"""Signs of life of the daemon's event loop, and the loss of a silent robot."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from pcmrs.clock import Clock
from pcmrs.devices.deadman import DEADMAN, beat_period
from pcmrs.messages import DeviceEvent
from pcmrs.service.supervisor import mark

SILENCE = 1.0
"""Time without joints after which the robot counts as lost, s of the machine."""

BEATS_MISSED = 10
"""Time without heartbeats of its node after which the robot counts as lost, in multiples of the deadman's time."""

HELD_UP = 0.1
"""Delay from which the watch itself was held up, s: it first takes the messages that have arrived meanwhile."""


class RobotWatch:
    """Watch that sends the loop's signs of life, and waits for the robot's joints and its node's heartbeats.

    Args:
        beat: Sends a sign of life, s of the machine, to the device nodes.
        connected: Returns whether the robot is connected by the state of the workflow.
        in_doubt: Returns whether a stopped robot has not confirmed that it stands: then no beats are sent, so that its
            node holds it by itself, too.
        report: `Dispatcher.report`.
        clock: The machine's clock.
        deadman: Deadman's time of the nodes, s of the machine.
    """

    def __init__(
        self,
        beat: Callable[[float], None],
        connected: Callable[[], bool],
        in_doubt: Callable[[], bool],
        report: Callable[[DeviceEvent], Awaitable[None]],
        clock: Clock,
        deadman: float = DEADMAN,
    ) -> None:
        self._beat = beat
        self._connected = connected
        self._in_doubt = in_doubt
        self._report = report
        self._clock = clock
        self._last_joints = self._last_beat = clock.monotonic()
        self._without_beats, self._period = BEATS_MISSED * deadman, beat_period(deadman)

    async def run(self) -> None:
        """Send beats and watch until cancelled.

        No beats are sent while a loss is handled: then the node holds the robot by itself, too.
        """
        while True:
            mark()
            begun = self._clock.monotonic()
            if not self._in_doubt():
                self._beat(begun)
            await self._clock.sleep(self._period)
            held_up = self._clock.monotonic() - begun - self._period > HELD_UP
            if not held_up and self._connected() and (text := self._loss()):
                await self.lose(text)

    def _loss(self) -> str:
        """Text why the robot counts as lost; empty while it does not."""
        now = self._clock.monotonic()
        if now - self._last_joints > SILENCE:
            return f"The robot has not reported its joints for {now - self._last_joints:.1f} s."
        if now - self._last_beat > self._without_beats:
            return f"The robot's node has sent no heartbeat for {now - self._last_beat:.1f} s."
        return ""

    async def lose(self, text: str) -> None:
        """Report the link to the robot as lost: motion is held, and the robot counts as disconnected."""
        if self._connected():
            await self._report(DeviceEvent(device="robot", code="link_lost", text=text, danger=True))

    def record_joints(self) -> None:
        """Note that the robot has reported its joints."""
        self._last_joints = self._clock.monotonic()

    def record_beat(self, sent: float) -> None:
        """Note that the robot's node has sent a heartbeat.

        Args:
            sent: Time of sending, s of the machine's clock here.
        """
        self._last_beat = max(self._last_beat, sent)
