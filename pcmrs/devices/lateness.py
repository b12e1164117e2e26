"""How late the messages of another process are, whatever its clock shows."""

from __future__ import annotations

from math import inf

WINDOW = 30.0
"""Clocks that drift apart are compared anew after at most twice this, s of the machine."""


AHEAD = 0.1
"""A stamp that is ahead of all others by more than this is wrong, s: it would make all others late."""

AGREED = 10
"""So many messages in a row that are ahead are right, and those before were late: the comparison begins anew."""


class Lateness:
    """Compares stamps of the sender's monotonic clock with ours; the quickest message of late is taken for not late.

    A delay that lasts longer than `WINDOW` comes to count as the link's own: what shows it is the gap when it begins.
    """

    def __init__(self) -> None:
        self._least = self._least_before = inf
        self._since = -inf
        self._ahead: dict[float, float] = {}

    def forget(self) -> None:
        """The sender has begun anew, perhaps with another clock."""
        self._least = self._least_before = inf
        self._ahead.clear()

    def hear(self, sent: float, now: float) -> float:
        """Takes a message for the comparison, and says by how much it is late, s.

        Args:
            sent: When it was sent, s of the sender's clock.
            now: When it came, s of ours.
        """
        if now - self._since > WINDOW:
            self._least_before, self._least, self._since = self._least, inf, now
        self._least = min(self._least, now - sent)
        return self.of(sent, now)

    def ahead(self, sent: float, now: float) -> float:
        """By how much a message seems to come before it could, s; 0 while there is nothing to compare."""
        least = min(self._least, self._least_before)
        return max(0.0, least - (now - sent)) if least < inf else 0.0

    def is_ahead(self, sent: float, now: float) -> bool:
        """Whether a stamp lies ahead of the others, so that its message says nothing.

        It does not where so many agree that the others must have been late: then they are forgotten.
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

    def of(self, sent: float, now: float) -> float:
        """By how much a message is later than the quickest one of late, s; 0 while there is nothing to compare."""
        least = min(self._least, self._least_before)
        return max(0.0, now - sent - least) if least < inf else 0.0

    def here(self, sent: float) -> float:
        """Return the moment of our clock at which a moment of the sender's clock came, s; minus infinity at first.

        The quickest message of late counts as one that took no time: by so much as it took, the moment comes too late.
        """
        least = min(self._least, self._least_before)
        return sent + least if least < inf else -inf
