"""What the parts of a dispatcher ask of it and report to it, and the completed command that they hand on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol

from pcmrs.dispatcher._run import C, D, Run
from pcmrs.dispatcher.locks import PendingCommand
from pcmrs.dispatcher.recorder import QueuedRow
from pcmrs.fsm import Change
from pcmrs.messages import Command, Decision, DeviceEvent, Reason, Verdict

Submission = Callable[[], list[asyncio.Future[Verdict]]]
"""Submits commands without awaiting anything, and returns the verdicts to come."""


@dataclass(frozen=True, slots=True)
class CompletedCommand(Generic[C, D]):
    """Command that has ended.

    Attributes:
        command: The command.
        verdict: Future of its verdict.
        decision: The decision.
        reason: Reason of the decision; None if it is accepted.
        pending: The pending command; None for a command that was rejected before it became one.
        run: Results of its checks and steps; None if there were none.
        change: Change of states to commit, if any.
        with_intent: Its intent is journalled together with the decision.
    """

    command: Command
    verdict: asyncio.Future[Verdict]
    decision: Decision
    reason: Reason | None = None
    pending: PendingCommand | None = None
    run: Run[C, D] | None = None
    change: Change | None = None
    with_intent: bool = False

    @property
    def changes(self) -> dict[str, Any]:
        """Changes of the procedure's data; only an accepted command has any."""
        return self.run.changes if self.run is not None and self.decision == "accepted" else {}

    @property
    def unlatches(self) -> bool:
        """True if it releases the latch; it does not acknowledge a Stop that came while it was journalled."""
        pending = self.pending
        accepted = self.decision == "accepted"
        return accepted and pending is not None and pending.spec.unlatches and pending.stopped is None


class Coordinator(Protocol[C, D]):
    """The dispatcher as its parts see it."""

    def admit(self, command: Command) -> asyncio.Future[Verdict]:
        """Admit a command at once; return its verdict, done or to come."""

    def objection(self, pending: PendingCommand) -> Reason | None:
        """Return why a pending command is not allowed now: failure, latch, lease or states; None if it is."""

    async def stop(self, source: str, reason: Reason | None = None, then: Submission = list) -> bool:
        """Stop everything; see `Dispatcher.stop`.

        Args:
            source: Who stops.
            reason: Why; by default that `source` has requested it.
            then: Submits the operations that follow from a danger event.
        """

    def fail_for(self, error: BaseException) -> Reason:
        """Fail-stop because of an error; return why nothing is accepted any more."""

    def on_completed(self, completed: CompletedCommand[C, D], verdict: Verdict) -> None:
        """Handle a command whose verdict has been given.

        Args:
            completed: The completed command.
            verdict: The verdict on it.
        """

    def publish_verdict(self, verdict: Verdict) -> None:
        """Publish a verdict, and before it the snapshot unless the command was rejected."""

    def publish_snapshot(self) -> None:
        """Publish the present snapshot."""

    def announce(self, event: DeviceEvent) -> QueuedRow:
        """Publish an event at once and queue its row; awaiting the result returns when the row is durable."""

    def announce_later(self, event: DeviceEvent) -> None:
        """Announce an event without waiting until its row is durable."""

    def record(self, event: DeviceEvent) -> QueuedRow:
        """Queue the row of an event at once, so that commands submitted from now on are journalled after it."""
