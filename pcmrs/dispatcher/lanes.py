"""Which attempts run, which wait, and which are turned away because of the others."""

from __future__ import annotations

from collections.abc import Iterable

from pcmrs.dispatcher.attempt import Attempt
from pcmrs.messages import Reason

MAX_WAITING = 32
"""Commands that may wait for locks; one more is rejected."""


class Lanes:
    """Locks are taken all at once, first come first served.

    Attributes:
        running: Attempts that hold their locks.
        waiting: Attempts that will be asked again when others end, in order of arrival.
    """

    def __init__(self, revokers: frozenset[str]) -> None:
        self.running: list[Attempt] = []
        self.waiting: list[Attempt] = []
        self._revokers = revokers

    def blocked(self, attempt: Attempt) -> bool:
        """Whether it is in the way of what runs, or of what came earlier."""
        others: Iterable[Attempt] = (*self.running, *self.waiting)
        return any(attempt.locks.conflicts(other.locks) for other in others)

    def why_not_wait(self, attempt: Attempt) -> Reason | None:
        """Why a blocked attempt is turned away.

        Nothing that moves or acts on the patient waits, nor does a plan change while something moves.
        """
        changes_plan = attempt.locks.writes & self._revokers
        if attempt.spec.blocked_when_latched or (changes_plan and any(other.moves for other in self.running)):
            busy = [other.name for other in self.running]
            text = f"{attempt.name} does not wait for {' and '.join(busy) or 'others'}: ask again when it has ended."
            return Reason(code="busy", text=text, fields={"running": busy})
        if len(self.waiting) >= MAX_WAITING:
            text = f"{len(self.waiting)} commands wait already, which is the limit: ask again later."
            return Reason(code="queue_full", text=text, fields={"limit": MAX_WAITING})
        return None

    def take_waiting(self) -> list[Attempt]:
        """Empties the queue and returns what was in it."""
        waiting, self.waiting = self.waiting, []
        return waiting

    def turn_away(self) -> list[Attempt]:
        """Empties the queue but for events, which say what has happened already, and returns what was taken out."""
        taken = [attempt for attempt in self.waiting if not attempt.spec.event]
        self.waiting = [attempt for attempt in self.waiting if attempt.spec.event]
        return taken
