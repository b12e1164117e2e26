"""What the dispatcher needs of a journal."""

from __future__ import annotations

from collections.abc import Awaitable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from pcmrs.messages import Command, DeviceEvent, Verdict

Joint = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Recorded:
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

    def recall(self, source: str, command_id: str) -> Recorded | None:
        """What is recorded of a command that was decided, also in an earlier run of the daemon.

        Called for every command, in the event loop: for one that is new it must not wait for the disk.
        """
