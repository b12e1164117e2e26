"""What the dispatcher needs of a journal, and what it writes there."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Generator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, Final, Protocol

import msgspec

from pcmrs.errors import JournalError
from pcmrs.messages import Command, DeviceEvent, Verdict

Joint = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class EarlierDecision:
    """A command that was decided.

    Attributes:
        verdict: On it.
        arguments: Of it.
    """

    verdict: Verdict
    arguments: Mapping[str, Any]


class Recorder(Protocol):
    """Makes decisions durable before anybody hears of them; raises `JournalError` when it cannot.

    Rows are queued when a method is called, and in that order.
    """

    def intent(self, command: Command, states: Joint) -> Awaitable[None]:
        """Resolves when it is durable that `command` is about to touch the world."""

    def decision(
        self, command: Command, verdict: Verdict, states: Joint, changes: Mapping[str, Any], *, with_intent: bool
    ) -> Awaitable[None]:
        """Resolves when the verdict is durable; `with_intent` puts the intent into the same commit."""

    def event(self, event: DeviceEvent, states: Joint) -> Awaitable[None]:
        """Resolves when a device event or a stop is durable."""

    def recall(self, source: str, command_id: str) -> EarlierDecision | None:
        """What is recorded of a command that was decided, also in an earlier run of the daemon.

        Called for every command, in the event loop: for one that is new it must not wait for the disk.
        """


class QueuedRow:
    """Awaiting it returns when the row is durable, or `failed` has been called.

    Args:
        queue: Queues the row, as the methods of `Recorder` do.
        failed: Called with the `JournalError` when it could not be queued or written.
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
        """Returns when the row is durable, or `failed` has been called."""
        try:
            if isinstance(self._row, JournalError):
                raise self._row
            await self._row
        except JournalError as error:
            self._failed(error)


LONGEST: Final = 4096
"""Arguments of a rejected command that are longer, bytes of their JSON, are clipped."""
BEGINNING: Final = 200
"""So much of them is kept, bytes."""
CLIPPED: Final = "clipped"
"""Stands in place of the arguments."""


def clipped(arguments: Mapping[str, Any]) -> Mapping[str, Any]:
    """The arguments, or what is kept of them where they are too long: their length, hash and beginning."""
    whole = msgspec.json.encode(arguments, enc_hook=repr, order="sorted")
    if len(whole) <= LONGEST:
        return arguments
    beginning = whole[:BEGINNING].decode(errors="replace")
    return {CLIPPED: {"bytes": len(whole), "sha256": sha256(whole).hexdigest(), "beginning": beginning}}
