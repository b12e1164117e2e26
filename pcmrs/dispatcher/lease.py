"""The lease of a cell: while one operator or teleoperator holds it, the others' commands are refused.

Commands of a branch that no workflow has acquire and release it. It is journalled like any decision, and does not
outlive the daemon.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from pcmrs.clock import Clock
from pcmrs.dispatcher.command_checks import EVENT_SOURCES
from pcmrs.fsm.finding import hint
from pcmrs.messages import Command, DeviceEvent, LeaseState, Reason
from pcmrs.messages.identity import HOLDING, LOCAL

LEASE: Final = "lease"
"""Branch of its commands, and source of its events."""
RENEW: Final = "renew"
LAPSED: Final = "lease_lapsed"
"""Code of the event that the holder has not renewed the lease in time."""
TAKEN: Final = "lease_taken"
"""Code of the Stop when the lease changes hands in motion."""


class Lease:
    """Lease of one cell.

    Args:
        clock: The cell's clock.
        required: True if somebody must hold it before commands are taken.

    Attributes:
        state: Its holder, and who else requests it; None while nobody holds it.
        renewed: Time of the last renewal, s of the clock.
    """

    def __init__(self, clock: Clock, *, required: bool = False) -> None:
        self._clock = clock
        self._required = required
        self._operations: dict[str, Callable[[Command], Reason | None]] = {
            "acquire": self._acquire,
            RENEW: self._renew,
            "release": self._release,
            "take_over": self._take_over,
            "confirm": self._confirm,
        }
        self.state: LeaseState | None = None
        self.renewed = 0.0

    @property
    def holder(self) -> str | None:
        """User who holds it; None if nobody does."""
        return None if self.state is None else self.state.holder

    def objection(self, command: Command) -> Reason | None:
        """Return why the lease does not allow a command now; None if it does."""
        if command.source.startswith(EVENT_SOURCES) or command.user == self.holder:
            return None
        if self.holder is None:
            text = "Nobody holds this cell: take its lease first, `pcmrs lease hold`."
            return Reason(code="no_lease", text=text) if self._required else None
        return None if command.role == "planner" else self._held()

    def decide(self, command: Command) -> Reason | None:
        """Perform a command of the branch `LEASE` at once, or return why it is refused."""
        operation = self._operations.get(command.operation)
        if operation is None:
            known = list(self._operations)
            text = f"{LEASE} has no operation {command.operation!r}; {hint(command.operation, known)}"
            return Reason(code="unknown_operation", text=text, fields={"operation": command.operation, "known": known})
        if command.role not in HOLDING:
            text = f"A {command.role} cannot hold the lease: {' or '.join(HOLDING)} can."
            return Reason(code="role_not_allowed", text=text, fields={"role": command.role})
        return operation(command)

    def lapsed(self, limit: float) -> str | None:
        """Return the holder who has not renewed it for `limit` s; a local holder need not renew."""
        away = self._clock.monotonic() - self.renewed
        return self.holder if self.holder != LOCAL and away > limit else None

    def follow(self, event: DeviceEvent) -> None:
        """End the lease if `event` says that it has lapsed."""
        if (event.device, event.code) == (LEASE, LAPSED):
            self.state = None

    def _acquire(self, command: Command) -> Reason | None:
        if self.holder not in (None, command.user):
            return self._held()
        self._give(command.user)
        return None

    def _renew(self, command: Command) -> Reason | None:
        if self.holder != command.user:
            return self._not_holder(command)
        self.renewed = self._clock.monotonic()
        return None

    def _release(self, command: Command) -> Reason | None:
        if self.holder != command.user:
            return self._not_holder(command)
        self.state = None
        return None

    def _take_over(self, command: Command) -> Reason | None:
        """Take over at once for a local user; all others request it, and the holder confirms."""
        if self.state is None or command.user in (self.holder, LOCAL):
            self._give(command.user)
        else:
            self.state = LeaseState(holder=self.state.holder, asking=command.user)
        return None

    def _confirm(self, command: Command) -> Reason | None:
        if self.state is None or self.holder != command.user:
            return self._not_holder(command)
        requested = command.arguments.get("user")
        if requested is None or requested != self.state.asking:
            text = (
                f"{requested} does not ask for the lease; {self.state.asking or 'nobody'} does. Give the argument user."
            )
            return Reason(code="bad_arguments", text=text, fields={"user": requested, "asking": self.state.asking})
        self._give(requested)
        return None

    def _give(self, user: str) -> None:
        asking = None if self.state is None or self.state.asking == user else self.state.asking
        self.state = LeaseState(holder=user, asking=asking)
        self.renewed = self._clock.monotonic()

    def _held(self) -> Reason:
        text = f"{self.holder} holds this cell: ask for it, `pcmrs lease hold --over`, or wait."
        return Reason(code="lease_held", text=text, fields={"holder": self.holder})

    def _not_holder(self, command: Command) -> Reason:
        text = f"{command.user} does not hold the lease; {self.holder or 'nobody'} does."
        return Reason(code="not_holder", text=text, fields={"holder": self.holder})


def lapse(holder: str, limit: float, *, moving: bool) -> DeviceEvent:
    """Event that a lease has ended because its holder was silent.

    Args:
        holder: User who held it.
        limit: Limit of the silence, s.
        moving: The robot moves: then the event is dangerous, and the robot is held.
    """
    text = f"{holder} has not renewed the lease for {limit:g} s and does not hold this cell any more."
    return DeviceEvent(device=LEASE, code=LAPSED, text=text, danger=moving, fields={"holder": holder})
