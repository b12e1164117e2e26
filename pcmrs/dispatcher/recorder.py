"""What the dispatcher needs of a journal."""

from __future__ import annotations

from collections.abc import Awaitable, Mapping
from typing import Any, Protocol

from pcmrs.messages import Command, DeviceEvent, Verdict

Joint = Mapping[str, str]


class Recorder(Protocol):
    """Makes decisions durable before anybody hears of them; raises `JournalError` when it cannot."""

    def intent(self, command: Command, states: Joint) -> Awaitable[None]:
        """Resolves when it is durable that `command` is about to touch the world."""

    def decision(
        self, command: Command, verdict: Verdict, states: Joint, changes: Mapping[str, Any], *, with_intent: bool
    ) -> Awaitable[None]:
        """Resolves when the verdict is durable; `with_intent` puts the intent into the same commit."""

    def event(self, event: DeviceEvent, states: Joint) -> Awaitable[None]:
        """Resolves when a device event or a stop is durable."""

    def recall(self, source: str, command_id: str) -> Verdict | None:
        """The verdict recorded for a command, also of an earlier run of the daemon."""
