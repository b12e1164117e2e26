"""Delay of messages from another process, without knowing the offset between its clock and ours."""

from __future__ import annotations

from math import inf

WINDOW = 30.0
"""The comparison of the clocks is renewed after at most twice this, because they drift apart, s of the machine."""

AHEAD = 0.1
"""A time stamp that is ahead of all others by more than this is wrong, s: it would make all others look late."""

AGREED = 10
"""Number of successive messages that are ahead and agree after which they are right, and the comparison restarts."""


class Lateness:
    """Lateness by time stamps of the sender's monotonic clock; the fastest recent message counts as not delayed.

    A delay that lasts longer than `WINDOW` becomes part of the comparison. It shows only as a gap when it begins.
    """

    def __init__(self) -> None:
        self._least = self._least_before = inf
        self._since = -inf
        self._ahead: dict[float, float] = {}

    def forget(self) -> None:
        """Restart the comparison, as when the sender was restarted, perhaps with another clock."""
        self._least = self._least_before = inf
        self._ahead.clear()

    def update(self, sent: float, now: float) -> float:
        """Add a message to the comparison, and return its delay, s.

        Args:
            sent: Time at which it was sent, s of the sender's clock.
            now: Time at which it arrived, s of our clock.
        """
        if now - self._since > WINDOW:
            self._least_before, self._least, self._since = self._least, inf, now
        self._least = min(self._least, now - sent)
        return self.delay(sent, now)

    def ahead(self, sent: float, now: float) -> float:
        """Return by how much the time stamp of a message is ahead of the fastest recent one, s; 0 at first.

        Args:
            sent: Time at which it was sent, s of the sender's clock.
            now: Time at which it arrived, s of our clock.
        """
        least = min(self._least, self._least_before)
        return max(0.0, least - (now - sent)) if least < inf else 0.0

    def is_ahead(self, sent: float, now: float) -> bool:
        """Return True if a time stamp is ahead of the others and so cannot be used.

        If `AGREED` such stamps agree, the others must have been late: the comparison restarts, and this returns False.

        Args:
            sent: Time at which the message was sent, s of the sender's clock.
            now: Time at which it arrived, s of our clock.
        """
        if self.ahead(sent, now) <= AHEAD:
            self._ahead.clear()
            return False
        if any(abs(now - sent - offset) > AHEAD for offset in self._ahead.values()):
            self._ahead.clear()
        self._ahead[sent] = now - sent
        if len(self._ahead) < AGREED:
            return True
        self.forget()
        return False

    def delay(self, sent: float, now: float) -> float:
        """Return the delay of a message relative to the fastest recent one, s; 0 at first.

        Args:
            sent: Time at which it was sent, s of the sender's clock.
            now: Time at which it arrived, s of our clock.
        """
        least = min(self._least, self._least_before)
        return max(0.0, now - sent - least) if least < inf else 0.0

    def to_local(self, sent: float) -> float:
        """Convert a time of the sender's clock to ours, s; minus infinity at first.

        The fastest recent message counts as one without delay, so the result is too late by the delay of that message.
        """
        least = min(self._least, self._least_before)
        return sent + least if least < inf else -inf
