"""The bus as devices see it, so that this package can be tested and reused without a bus."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, Protocol, TypeVar

import msgspec

M = TypeVar("M", bound=msgspec.Struct)


class Link(Protocol):
    """Messages by key. Keys are relative to the cell, such as ``state/joints`` or ``dev/robot/cmd``."""

    def publish(self, key: str, message: msgspec.Struct) -> None:
        """Publish a message; never blocks.

        Args:
            key: Relative key.
            message: Newest value of the key.
        """

    def subscribe(self, key: str, kind: type[M], handler: Callable[[str, M], None]) -> None:
        """Call a handler in the event loop for every message.

        Args:
            key: Relative key expression.
            kind: Type of the messages.
            handler: Called with relative key and message.
        """

    def listen(self, key: str, kind: type[M], handler: Callable[[str, M], None]) -> None:
        """Call a handler for every message in the thread that receives it, without waiting for the event loop.

        Args:
            key: Relative key expression.
            kind: Type of the messages.
            handler: Called with relative key and message, in any thread.
        """

    def when_lost(self, handler: Callable[[str], None]) -> None:
        """Call a handler in the event loop when an event was not delivered: too many were waiting, or it is malformed.

        Args:
            handler: Called with the relative key of the event; its content is lost.
        """

    def serve(self, key: str, kind: type[M], handler: Callable[[str, M], Awaitable[msgspec.Struct]]) -> None:
        """Answer requests, each in its own task.

        Args:
            key: Relative key expression.
            kind: Type of the requests.
            handler: Returns the reply from relative key and request.
        """

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
        """Send a request and return the reply.

        Args:
            key: Relative key that another process serves.
            message: The request.
            reply: Type of the reply.
            timeout: Longest wait for the reply, s of the machine.
            sender: Name of the sender. Its requests are sent in their order and never wait for another sender. Empty
                for a request whose order does not matter.
            urgent: True for a request that goes ahead of those that are not urgent.

        Raises:
            UnknownOutcomeError: No reply came within `timeout`, or the answering process ended first.
        """

    def alive(self, component: str) -> Any:
        """Declare a liveliness token for this process."""
