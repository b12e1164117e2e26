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
    """A timer that runs from the last sign of life of the daemon's loop, however late that became known.

    Args:
        limit: See `DEADMAN`.
        at_risk: Whether anything moves or could fire.
        act: Makes that safe; gets the silence, s.
        clock: The machine's.

    Attributes:
        limit: See `DEADMAN`.
        late: Heartbeats whose sign of life was more than `limit` old when they came.
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
        self._begun = clock.monotonic()
        self._rests_until = self._begun
        self._session = ""
        self._ended: set[str] = set()
        self._number = 0
        self._alive = 0.0

    @property
    def silence(self) -> float:
        """Time since the last sign of life of the daemon's loop, s of the machine."""
        return self._clock.monotonic() - self._last_alive()

    def hear(self, beat: Beat) -> None:
        """Takes a heartbeat of the daemon; of an earlier session, or again, it says nothing."""
        if beat.session in self._ended:
            return
        if beat.session != self._session:
            self._ended.add(self._session)
            self._session, self._number, self._alive = beat.session, 0, beat.alive
            self.lateness.forget()  # another daemon, perhaps of another start of its machine
        if beat.number <= self._number:
            return
        self._number = beat.number
        self.lateness.hear(beat.sent, self._clock.monotonic())
        self._alive = max(self._alive, beat.alive)
        self.late += self.lateness.of(beat.alive, self._clock.monotonic()) > self.limit

    def _last_alive(self) -> float:
        """By our clock; before the first beat, when this began."""
        return max(self._begun, self.lateness.here(self._alive))

    def _due(self) -> float:
        """When to act unless another sign of life becomes known."""
        return max(self._last_alive() + self.limit, self._rests_until)

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
            if self._clock.monotonic() < self._due():
                continue
            rest = self.limit / 4  # soon: something may begin to move unasked
            if await self._at_risk():
                await self._act(self.silence)
                rest = self.limit
            self._rests_until = self._clock.monotonic() + rest

    async def _wait(self) -> None:
        """Until the timer was due when this began; a little longer where this process was held up itself."""
        due = self._due()
        await self._clock.sleep(due - self._clock.monotonic())
        if self._clock.monotonic() - due > HELD_UP:
            await self._clock.sleep(LISTENING)
