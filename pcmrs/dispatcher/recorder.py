"""Interface of the dispatcher to a journal."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Generator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from pcmrs.errors import JournalError
from pcmrs.messages import Command, DeviceEvent, Verdict

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
    """Makes decisions durable before they are published; raises `JournalError` if it cannot.

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
