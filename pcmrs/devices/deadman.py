"""The deadman of a device node: what moves is made safe when nothing fresh is heard of the daemon."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from pcmrs.clock import Clock
from pcmrs.devices.lateness import Lateness
from pcmrs.messages import Beat

DEADMAN = 0.1
"""Without a fresh heartbeat for so long what moves is held, s of the machine, unless configured otherwise."""

BEATS = 4
"""Heartbeats are sent so often within the deadman's time."""

HELD_UP = 0.012
"""A watch that wakes up so much too late was held up itself, s of the machine."""

LISTENING = 0.008
"""Then it first hears for so long what has arrived meanwhile, s of the machine."""


def beat_period(deadman: float) -> float:
    """Time between two heartbeats, of the daemon and of the nodes, s of the machine."""
    return deadman / BEATS


class Deadman:
    """A timer that every fresh heartbeat of the daemon arms anew.

    Args:
        limit: See `DEADMAN`.
        at_risk: Whether anything moves or could fire.
        act: Makes that safe, told how long nothing fresh was heard, s.
        clock: The machine's.

    Attributes:
        limit: See `DEADMAN`.
        late: Heartbeats that were more than `limit` late, and so not fresh.
        lateness: Of what the daemon sends.
    """

    def __init__(
        self,
        limit: float,
        at_risk: Callable[[], Awaitable[bool]],
        act: Callable[[float], Awaitable[None]],
        clock: Clock,
    ) -> None:
        self.limit = limit
        self.late = 0
        self.lateness = Lateness()
        self._at_risk, self._act, self._clock = at_risk, act, clock
        self._heard = clock.monotonic()
        self._due = self._heard + limit
        self._number = 0

    @property
    def silence(self) -> float:
        """Time since the last fresh heartbeat, s of the machine."""
        return self._clock.monotonic() - self._heard

    def hear(self, beat: Beat) -> None:
        """Takes a heartbeat of the daemon; one that is late does not count."""
        if beat.number == self._number:
            return  # the same one again says nothing new
        now = self._clock.monotonic()
        if beat.number < self._number:
            self.lateness.forget()  # another daemon, perhaps of another start of its machine
        self._number = beat.number
        if self.lateness.hear(beat.sent, now) > self.limit:
            self.late += 1
        else:
            self._heard, self._due = now, now + self.limit

    async def heard(self) -> bool:
        """Whether the daemon is there: at once, or within `limit` from now."""
        end = self._clock.monotonic() + self.limit
        while self.silence > self.limit:
            if self._clock.monotonic() >= end:
                return False
            await self._clock.sleep(LISTENING)
        return True

    async def run(self) -> None:
        """Watches until cancelled."""
        while True:
            await self._wait()
            if self._clock.monotonic() < self._due:
                continue
            if await self._at_risk():
                await self._act(self.silence)
                self._due = self._clock.monotonic() + self.limit
            else:
                self._due = self._clock.monotonic() + self.limit / 4  # soon: something may begin to move unasked

    async def _wait(self) -> None:
        """Until the timer was due when this began; a little longer where this process was held up itself."""
        due = self._due
        await self._clock.sleep(due - self._clock.monotonic())
        if self._clock.monotonic() - due > HELD_UP:
            await self._clock.sleep(LISTENING)
