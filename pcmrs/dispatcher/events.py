"""Interfaces of the dispatcher: its events, the journal and listeners that get them, and what its parts ask of it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Generator, Mapping
from dataclasses import dataclass
from typing import Any, Generic, Protocol

from pcmrs.dispatcher.locks import PendingCommand
from pcmrs.dispatcher.workflow import C, D, Run
from pcmrs.errors import JournalError
from pcmrs.fsm import Change
from pcmrs.messages import Command, Decision, DeviceEvent, Reason, Snapshot, Verdict

DAEMON = "daemon"
"""Source of the daemon's reports about itself."""
SHUTDOWN = "shutdown"
"""Source of the Stop of an orderly shutdown: it need not be acknowledged."""
FAIL_STOP = "fail_stop"
"""Code of the event that nothing is accepted any more; its field ``reason`` is the code of why."""
NOT_CONFIRMED = "hold_not_confirmed"
"""Code of the event that it is unknown whether the robot stands."""
PRESSED_AGAIN = "stop_pressed_again"
"""Code of the event that counts the presses that have joined a pending Stop."""
ACTIVITY_STARTED, ACTIVITY_ENDED = "activity_started", "activity_ended"
"""Codes of the events that an activity is about to start, and that it has ended. The journal has the first before the
activity moves anything, and the second after the robot stands or a motion has taken over."""
TIMER_STARTED, TIMER_ENDED = "timer_started", "timer_ended"
"""Codes of the events that a timer has begun, and that its state was left."""
REOPENED = DeviceEvent(
    device="journal",
    code="journal_reopened",
    text="The journal can be written again: look at the cell, then acknowledge.",
    danger=True,
)


SCENE_NOT_CLEAR = "scene_not_clear"
"""Code of the rejection of a motion while the scene does not allow it; see `Dispatcher.bar_motion`."""


def stopped(source: str, reason: Reason, number: int) -> DeviceEvent:
    """Event that everything was stopped.

    Args:
        source: Who has stopped.
        reason: Why.
        number: Number of the Stop.
    """
    fields = {**reason.fields, "stop": number}
    return DeviceEvent(device=source, code=reason.code, text=reason.text, danger=True, fields=fields)


def pressed_again(source: str, number: int, joined: Mapping[str, int]) -> DeviceEvent:
    """Event that a Stop was pressed again while it was pending.

    Args:
        source: Who has stopped first.
        number: Number of the Stop.
        joined: Number of further presses of each source.
    """
    presses = sum(joined.values())
    text = f"Stop {number} was pressed {presses} more times before the robot stood, by {len(joined)} sources."
    fields = {"stop": number, "presses": presses, "by": dict(joined)}
    return DeviceEvent(device=source, code=PRESSED_AGAIN, text=text, fields=fields)


def failed(reason: Reason) -> DeviceEvent:
    """Event that the dispatcher accepts nothing any more."""
    return DeviceEvent(device=DAEMON, code=FAIL_STOP, text=reason.text, danger=True, fields={"reason": reason.code})


def not_confirmed(source: str) -> DeviceEvent:
    """Event that robot or stimulator have not confirmed that they are stopped, as `source` has requested."""
    text = "Robot or stimulator have not confirmed that they are stopped: look, and use their own emergency stop."
    return DeviceEvent(device=source, code=NOT_CONFIRMED, text=text, danger=True)


Joint = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class EarlierDecision:
    """A command that was decided.

    Attributes:
        verdict: The verdict on it.
        arguments: Its arguments.
    """

    verdict: Verdict
    arguments: Mapping[str, Any]


class Recorder(Protocol):
    """Make decisions durable before they are published; raise `JournalError` if it cannot.

    Rows are queued when a method is called, and in that order.
    """

    def intent(self, command: Command, states: Joint) -> Awaitable[None]:
        """Journal that a command is about to act on the world; awaiting it returns when the row is durable.

        Args:
            command: The command.
            states: Joint state.
        """

    def decision(
        self, command: Command, verdict: Verdict, states: Joint, changes: Mapping[str, Any], *, with_intent: bool
    ) -> Awaitable[None]:
        """Journal a verdict; awaiting it returns when the row is durable.

        Args:
            command: The command.
            verdict: The verdict on it.
            states: Joint state once everything that is being journalled is committed.
            changes: Changed fields of the procedure's data.
            with_intent: Journal the intent in the same commit.
        """

    def event(self, event: DeviceEvent, states: Joint) -> Awaitable[None]:
        """Journal a device event or a Stop; awaiting it returns when the row is durable.

        Args:
            event: The event.
            states: Joint state once everything that is being journalled is committed.
        """

    def recall(self, source: str, command_id: str) -> EarlierDecision | None:
        """Return the record of a command that was decided, also in an earlier run of the daemon; None for a new one.

        It is called for every command, in the event loop: for a new one it must not wait for the disk.

        Args:
            source: Source of the command.
            command_id: Id that the source has given it.
        """


class QueuedRow:
    """Row on its way to the disk; awaiting it returns when it is durable, or `failed` has been called.

    Args:
        queue: Queues the row, as the methods of `Recorder` do.
        failed: Called with the `JournalError` if the row could not be queued or written.
    """

    def __init__(self, queue: Callable[[], Awaitable[None]], failed: Callable[[JournalError], object]) -> None:
        self._failed = failed
        self._row: Awaitable[None] | JournalError
        try:
            self._row = queue()
        except JournalError as error:
            self._row = error

    def __await__(self) -> Generator[Any, None, None]:
        return self.durable().__await__()

    async def durable(self) -> None:
        """Return when the row is durable, or `failed` has been called."""
        try:
            if isinstance(self._row, JournalError):
                raise self._row
            await self._row
        except JournalError as error:
            self._failed(error)


class DispatcherListener:
    """Receive notifications of a dispatcher, synchronously in its event loop.

    A subclass overrides what it needs. If it raises, the loop's exception handler gets the error, and everything else
    goes on.
    """

    def on_stop(self) -> None:
        """Handle a Stop, by whatever source; its latch is set already."""

    def on_failure(self) -> None:
        """Handle a failure after which the dispatcher accepts nothing any more; see `Dispatcher.broken`."""

    def on_accepted(self, command: Command) -> None:
        """Handle a command that was accepted, as soon as it is committed."""

    def on_publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        """Handle a new snapshot, verdict or device event."""


class Listeners:
    """Notify all listeners, in the order in which they were added."""

    def __init__(self) -> None:
        self._listeners: list[DispatcherListener] = []

    def add(self, listener: DispatcherListener) -> None:
        """Add a listener."""
        self._listeners.append(listener)

    def notify_stop(self) -> None:
        """Notify all of a Stop."""
        for listener in self._listeners:
            _guarded(listener.on_stop)

    def notify_failure(self) -> None:
        """Notify all of a failure."""
        for listener in self._listeners:
            _guarded(listener.on_failure)

    def notify_accepted(self, command: Command) -> None:
        """Notify all of an accepted command."""
        for listener in self._listeners:
            _guarded(listener.on_accepted, command)

    def publish(self, message: Snapshot | Verdict | DeviceEvent) -> None:
        """Hand a message to all."""
        for listener in self._listeners:
            _guarded(listener.on_publish, message)


def _guarded(notify: Callable[..., object], *arguments: object) -> None:
    """Notify one listener: the loop reports its failure, which keeps nobody from stopping."""
    try:
        notify(*arguments)
    except Exception as error:
        context = {"message": f"{notify} has failed", "exception": error}
        asyncio.get_running_loop().call_exception_handler(context)


Submission = Callable[[], list[asyncio.Future[Verdict]]]
"""Function that submits commands without awaiting anything, and returns the verdicts to come."""


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
