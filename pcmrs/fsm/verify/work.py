"""How much the searches of one verification may cost together, and how far they have come."""

from __future__ import annotations

from pcmrs.fsm.verify.search import Progress, TooManyError

MOMENTS_PER_STATE = 32
"""So many times the limit of joint states may moments be looked at, in all searches and ways back together."""

LEAST_WORK = 1_000_000
"""So many may always be looked at, however low the limit."""


class Work:
    """Counts the moments that are looked at.

    Args:
        limit: How many joint states there may be.
        progress: Told now and then how many moments have been looked at, and how many are known.
        done: So many joint states have been looked at before.
    """

    def __init__(self, limit: int, progress: Progress | None = None, done: int = 0) -> None:
        self._limit = max(LEAST_WORK, MOMENTS_PER_STATE * limit)
        self._left = self._limit
        self._progress = progress
        self._done = done

    def spend(self, moments: int) -> None:
        """Notes that so many have been looked at, or what takes as long. Raises `TooManyError`."""
        self._check(moments)
        self._left -= moments
        self._done += moments

    def follow(self, looked_at: int, known: int) -> None:
        """Progress of a search whose work is not yet spent. Raises `TooManyError`."""
        self._check(known)
        if self._progress is not None:
            self._progress(self._done + looked_at, self._done + known)

    def _check(self, moments: int) -> None:
        if moments > self._left:
            text = f"The properties watch too many joint states and running operations: over {self._limit} moments. "
            raise TooManyError(f"{text}Make it fewer properties of `running`, `leads_to` or Stop, or raise the limit.")
