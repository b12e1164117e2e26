"""Last signs of life of the device nodes, by their heartbeats' time of sending."""

from __future__ import annotations

from math import inf

from pcmrs.devices.lateness import Lateness
from pcmrs.messages import NodeBeat


class NodeBeats:
    """Heartbeats of one node, as they were sent: a delayed one does not show that the node lives now.

    The fastest recent heartbeat counts as not delayed, as in the deadman of the node.
    """

    def __init__(self) -> None:
        self._lateness = Lateness()
        self._session = ""
        self._number = 0
        self._last = -inf

    def take(self, beat: NodeBeat, now: float) -> float:
        """Take a heartbeat, and return the time of the last sign of life, s of our clock; minus infinity at first.

        A heartbeat that was overtaken, or whose time stamp is ahead of the others, does not count.

        Args:
            beat: The heartbeat.
            now: Time at which it arrived, s of our clock.
        """
        session = beat.gate.node if beat.gate is not None else ""
        # Only a device that acts has a session; the numbers of another one restart with its node.
        restarted = session != self._session or (not session and beat.number <= self._number)
        if restarted:
            self._session = session
            self._lateness.forget()
        elif beat.number <= self._number:
            return self._last
        self._number = beat.number
        if not self._lateness.is_ahead(beat.sent, now):
            self._lateness.update(beat.sent, now)
            self._last = max(self._last, self._lateness.to_local(beat.sent))
        return self._last
