"""The Stops of one dispatcher: their numbers, what an acknowledgement waits for, and which one it answers."""

from __future__ import annotations

import asyncio
from typing import Any

from pcmrs.clock import Clock
from pcmrs.messages import Command, Reason, StopState

LOCAL = "local"
"""Who is on the cell's own machine: the only one who may acknowledge without naming the Stop."""

YOUNG = 1.0
"""A Stop so young is acknowledged by its number only: who does not name it may not know of it yet, s of the clock."""

NUMBERS = 1_000_000
"""Stops of one run of the daemon have numbers within so many, so that no number comes twice across restarts."""

STANDSTILL = "standstill"
"""An acknowledgement waits for this while a hold is under way."""

PENDING = "stop_pending"
"""Code of the refusal of an acknowledgement that has to wait."""

UNNAMED = "stop_not_named"
"""Code of the refusal of an acknowledgement that has to name its Stop."""

NO_STOP = StopState()


class Stops:
    """Numbers Stops, and says what is pending.

    Args:
        clock: The cell's clock.

    Attributes:
        state: Of the newest Stop; number 0 before the first one.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._since = 0.0
        self.state = NO_STOP
        self._pending: dict[asyncio.Future[Any], str] = {}
        self._first = 0

    def number_from(self, start: int) -> None:
        """Stops of this run get numbers greater than those of all earlier runs.

        Args:
            start: Grows with each run; sequence of the journal's row of this start.
        """
        self._first = start * NUMBERS

    def begin(self) -> None:
        """A Stop begins: it has its number before anything is awaited."""
        number = max(self.state.number, self._first) + 1
        self._since = self._clock.monotonic()
        self.state = StopState(number=number, pending=self._waits_for(), confirmed=False)

    def stood(self, number: int) -> None:
        """Standstill was measured after the hold of Stop `number`."""
        if number == self.state.number:
            self.state = StopState(number=number, pending=self.state.pending, confirmed=True)

    def wait_for(self, what: str, end: asyncio.Future[Any]) -> None:
        """No acknowledgement before `end` is done."""
        if end not in self._pending:  # Stops that follow each other quickly wait for the same hold
            end.add_done_callback(self._settle)
        self._pending[end] = what
        self._show()

    @property
    def standing(self) -> bool:
        """Whether no hold is under way."""
        return STANDSTILL not in self._pending.values()

    def objection(self, command: Command, *, latched: bool) -> Reason | None:
        """Why `command` may not acknowledge now; None where it may."""
        named, state = command.arguments.get("stop"), self.state
        if named is not None and named != state.number:
            text = f"Stop {named} is not the newest one, which is Stop {state.number}: look why it was pressed, then "
            text += "acknowledge that one."
            return Reason(code="stop_outdated", text=text, fields={"stop": named, "newest": state.number})
        if self._pending:
            text = (
                f"Stop {state.number} cannot be acknowledged yet; it waits for: {', '.join(state.pending)}. Ask again."
            )
            return Reason(code=PENDING, text=text, fields={"stop": state.number, "pending": state.pending})
        if named is not None or not latched:
            return None
        if command.user != LOCAL:
            text = f"Name the Stop that you acknowledge: stop = {state.number}, the newest one."
            return Reason(code=UNNAMED, text=text, fields={"newest": state.number})
        age = self._clock.monotonic() - self._since
        if age < YOUNG:
            text = f"Stop {state.number} is only {age:.1f} s old, limit {YOUNG:g} s: name it (stop = {state.number}), "
            text += "or look, and ask again."
            return Reason(code=UNNAMED, text=text, fields={"newest": state.number, "age": age})
        return None

    def _settle(self, end: asyncio.Future[Any]) -> None:
        self._pending.pop(end, None)  # two Stops may share one hold
        self._show()

    def _show(self) -> None:
        state = self.state
        self.state = StopState(number=state.number, pending=self._waits_for(), confirmed=state.confirmed)

    def _waits_for(self) -> list[str]:
        return sorted(set(self._pending.values()))
