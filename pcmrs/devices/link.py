"""The bus as devices see it, so that this package needs no bus to be tested or reused."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, Protocol, TypeVar

import msgspec

M = TypeVar("M", bound=msgspec.Struct)


class Link(Protocol):
    """Keys are relative to the cell, such as ``state/joints`` or ``dev/robot/cmd``."""

    def publish(self, key: str, message: msgspec.Struct) -> None:
        """Sends the newest value of a key; never blocks."""

    def subscribe(self, key: str, kind: type[M], handler: Callable[[str, M], None]) -> None:
        """Calls `handler(key, message)` in the event loop for every message of `kind`."""

    def listen(self, key: str, kind: type[M], handler: Callable[[str, M], None]) -> None:
        """Calls `handler(key, message)` where the message is received, in any thread: at once, past the event loop."""

    def serve(self, key: str, kind: type[M], handler: Callable[[str, M], Awaitable[msgspec.Struct]]) -> None:
        """Answers requests on `key`, each in a task of its own, with the handler's message."""

    async def request(
        self,
        key: str,
        message: msgspec.Struct,
        reply: type[M],
        timeout: float,
        sender: str = "",
        *,
        urgent: bool = False,
    ) -> M:
        """Asks and returns the reply.

        Args:
            key: On which somebody serves.
            message: The request.
            reply: Type of the reply.
            timeout: s of the machine.
            sender: Requests of one sender leave in the order in which they are made, and wait for no other sender;
                empty for a request whose order does not matter.
            urgent: It goes ahead of requests that are not.

        Raises:
            UnknownOutcomeError: Nobody answered within `timeout` (s of the machine), or the answering
                process ended before it did.
        """

    def alive(self, component: str) -> Any:
        """Declares a liveliness token for this process."""
