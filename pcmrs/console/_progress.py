"""Remaining time of a running operation, from its progress so far. Pure."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from pcmrs.messages import Running

EARLIEST: Final = 0.1
"""Progress from which the time so far predicts the rest."""


class RemainingTime:
    """Predicts the remaining time of the operation that runs.

    Args:
        now: Returns the present time, s of a steady clock.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._id = ""
        self._first = (0.0, 0.0)

    def of(self, running: Running) -> float | None:
        """Return the predicted remaining time of an operation, s; None while it is too early to say.

        Args:
            running: The operation, with its progress.
        """
        now = self._now()
        if running.id != self._id:
            self._id, self._first = running.id, (now, running.progress)
        since, before = self._first
        gained = running.progress - before
        if gained < EARLIEST:
            return None
        return (now - since) * (1.0 - running.progress) / gained
