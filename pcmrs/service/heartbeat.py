"""The daemon's heartbeats for the device nodes."""

from __future__ import annotations

from collections.abc import Callable

from pcmrs.clock import Clock
from pcmrs.devices.node import DAEMON_BEAT
from pcmrs.messages import Beat


class Heartbeat:
    """Sends a beat for every sign of life of the daemon's loop.

    Args:
        publish: `Bus.publish`.
        session: Of this start of the daemon.
        clock: The machine's.
    """

    def __init__(self, publish: Callable[[str, Beat], None], session: str, clock: Clock) -> None:
        self._publish, self._session, self._clock = publish, session, clock
        self._number = 0

    def beat(self, alive: float) -> None:
        """Sends a sign of life that the loop gave at `alive`, s of the machine."""
        self._number += 1
        sent = self._clock.monotonic()
        self._publish(DAEMON_BEAT, Beat(number=self._number, session=self._session, alive=alive, sent=sent))
