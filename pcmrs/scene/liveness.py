"""Liveness of a source of scene events: it sends new frames in time, not too many events, and can see the scene."""

from __future__ import annotations

from typing import Final, Literal

from pcmrs.bucket import TokenBucket
from pcmrs.clock import Clock
from pcmrs.devices.lateness import AGREED, AHEAD
from pcmrs.messages.scene_event import BLIND, SceneEvent
from pcmrs.scene.settings import SceneSourceSettings

Loss = Literal["silent", "stale", "flooded", "blind", "two_senders"]
"""Why a source is lost: it sends nothing; its frames are old or always the same; it sends too much; it says so; two
processes send for it."""

NEVER: Final = float("-inf")

DRIFT: Final = 1e-3
"""Largest difference of the rates of two clocks, also while both are being set to the time of day, s/s."""


class _Delay:
    """Delay of events beyond the fastest one of a session, by time stamps of the sender's clock.

    Unlike `pcmrs.devices.lateness.Lateness`, it forgets the fastest event by the drift of the clocks only: a delay that
    lasts for minutes does not count as normal.
    """

    def __init__(self) -> None:
        self._offset: float | None = None
        self._compared = 0.0
        self._ahead: dict[float, float] = {}

    def take(self, sent: float, now: float) -> float | None:
        """Return the delay of an event, s; None if its time stamp is ahead of the others and so cannot be used.

        If `AGREED` stamps in succession are ahead and agree, the others were late, and the comparison restarts.

        Args:
            sent: Time at which it was sent, s of the sender's clock.
            now: Time at which it arrived, s of our clock.
        """
        offset = now - sent
        if self._offset is None:
            self._offset, self._compared = offset, now
        least = self._offset + DRIFT * (now - self._compared)
        if offset >= least - AHEAD:
            self._ahead.clear()
        elif not self._agrees(sent, offset):
            return None
        self._offset, self._compared = min(least, offset), now
        return offset - self._offset

    def _agrees(self, sent: float, offset: float) -> bool:
        if any(abs(offset - other) > AHEAD for other in self._ahead.values()):
            self._ahead.clear()
        self._ahead[sent] = offset
        return len(self._ahead) >= AGREED


class Liveness:
    """Liveness of one source.

    The clocks of a source and of this machine differ by an unknown offset, which drifts. The smallest difference of
    arrival and sending in a session stands for it, so that the delay of an event beyond the fastest one counts towards
    its age.

    Args:
        settings: Settings of the source.
        clock: Clock of the machine.

    Attributes:
        lost: Why the source is lost; None while it is not.
        blind: Reason of the newest report that the source cannot see.
        ahead: Number of events that were dropped, since their time stamp was ahead of the others.
    """

    def __init__(self, settings: SceneSourceSettings, clock: Clock) -> None:
        self.settings = settings
        self.lost: Loss | None = None
        self.blind = ""
        self.ahead = 0
        self._clock = clock
        self._bucket = TokenBucket(settings.rate_hz, max(1, round(settings.rate_hz)), clock)
        self._session: str | None = None
        self._newest = NEVER
        self._delay = _Delay()
        now = clock.monotonic()
        self._received = self._fresh = now
        self._flooded = self._said_blind = self._doubled = NEVER
        self._good_since: float | None = None

    def take(self, event: SceneEvent) -> bool:
        """Take an event of the source; return True if it is fresh, so that its content counts.

        Args:
            event: The event.
        """
        now, limit = self._clock.monotonic(), self.settings.silent_after
        if event.session == self._session:
            self._received = now
        if not self._bucket.take():
            self._flooded = now
            return False
        if event.session != self._session and not self._begin_session(event.session, now):
            self._doubled = now
            return False
        delay = self._delay.take(event.sent, now)
        if delay is None:
            self.ahead += 1
            return False
        age = event.sent - event.captured + delay
        if event.captured > event.sent or age > limit or event.captured < self._newest:
            return False
        if event.label == BLIND:
            self._said_blind, self.blind = now, event.reason
        if event.captured > self._newest:
            self._newest, self._fresh = event.captured, now
        return now - self._fresh <= limit  # a frame that is sent again and again shows nothing new

    def _begin_session(self, session: str, now: float) -> bool:
        """Take another session if the present one is silent; return False if it still sends."""
        if self._session is not None:
            if now - self._received <= self.settings.silent_after:
                return False
            self.check()  # its silence is a loss, also if nobody has looked since
        self._session, self._newest, self._delay, self._received = session, NEVER, _Delay(), now
        return True

    def check(self) -> Loss | None:
        """Update `lost`, and return it."""
        now, settings = self._clock.monotonic(), self.settings
        found = self._found(now)
        if found is not None:
            self.lost, self._good_since = found, None
        elif self.lost is not None:
            self._good_since = now if self._good_since is None else self._good_since
            if now - self._good_since >= settings.returns_after:
                self.lost = None
        return self.lost

    def _found(self, now: float) -> Loss | None:
        limit = self.settings.silent_after
        if now - self._flooded <= limit:
            return "flooded"
        if now - self._doubled <= limit:
            return "two_senders"
        if now - self._said_blind <= limit:
            return "blind"
        if now - self._received > limit:
            return "silent"
        return "stale" if now - self._fresh > limit else None
