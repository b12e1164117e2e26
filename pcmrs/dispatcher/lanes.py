"""Which attempts run, which wait, and which are turned away because of the others."""

from __future__ import annotations

from collections.abc import Iterable

from pcmrs.dispatcher.attempt import Attempt
from pcmrs.messages import Reason

MAX_WAITING = 32
"""Commands that may wait for locks; one more is rejected. Events are not counted: each waits once at most."""


class Lanes:
    """Locks are taken all at once, first come first served; events go ahead of commands.

    Attributes:
        running: Attempts that hold their locks.
        waiting: Attempts that will be asked again when others end, in order of arrival.
    """

    def __init__(self, revokers: frozenset[str]) -> None:
        self.running: list[Attempt] = []
        self.waiting: list[Attempt] = []
        self._revokers = revokers

    @property
    def moving(self) -> bool:
        """Whether a motion runs, or waits to run."""
        return any(attempt.moves for attempt in (*self.running, *self.waiting))

    def blocked(self, attempt: Attempt) -> bool:
        """Whether it is in the way of what runs, or of what goes ahead of it."""
        return any(self._in_the_way_of(attempt))

    def why_not_wait(self, attempt: Attempt) -> Reason | None:
        """Why a blocked attempt is turned away; events never are.

        Nothing that moves or acts on the patient waits, nor does a plan change while something moves. A motion waits
        for events that take no step in the world: they end as soon as the disk has them.
        """
        if attempt.spec.event or (attempt.moves and self._may_wait(attempt)):
            return None
        changes_plan = attempt.locks.writes & self._revokers
        if attempt.spec.blocked_when_latched or (changes_plan and self.moving):
            return self.busy(attempt)
        if sum(not other.spec.event for other in self.waiting) >= MAX_WAITING:
            text = f"{MAX_WAITING} commands wait already, which is the limit: ask again later."
            return Reason(code="queue_full", text=text, fields={"limit": MAX_WAITING})
        return None

    def busy(self, attempt: Attempt) -> Reason:
        """Says that an attempt does not wait for the others."""
        busy = [other.name for other in self.running]
        text = f"{attempt.name} does not wait for {' and '.join(busy) or 'others'}: ask again when it has ended."
        return Reason(code="busy", text=text, fields={"running": busy})

    def wait(self, attempt: Attempt) -> Attempt | None:
        """Has an attempt wait; returns the one of the same event that it replaces, if any: the newest counts."""
        replaced = next((other for other in self.waiting if attempt.replaces(other)), None)
        if replaced is not None:
            self.waiting.remove(replaced)
        self.waiting.append(attempt)
        return replaced

    def take_waiting(self) -> list[Attempt]:
        """Empties the queue and returns what was in it, events first."""
        waiting, self.waiting = self.waiting, []
        return sorted(waiting, key=lambda attempt: not attempt.spec.event)

    def turn_away(self) -> list[Attempt]:
        """Empties the queue but for events, which say what has happened already, and returns what was taken out."""
        taken = [attempt for attempt in self.waiting if not attempt.spec.event]
        self.waiting = [attempt for attempt in self.waiting if attempt.spec.event]
        return taken

    def _may_wait(self, motion: Attempt) -> bool:
        if any(other.moves for other in self.waiting):
            return False
        return all(other.spec.event and not other.worldly for other in self._in_the_way_of(motion))

    def _in_the_way_of(self, attempt: Attempt) -> Iterable[Attempt]:
        ahead = (other for other in self.waiting if other.spec.event or not attempt.spec.event)
        return (other for other in (*self.running, *ahead) if attempt.locks.conflicts(other.locks))
