"""A bus in memory, with the test as everybody else on it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Awaitable, Callable
from typing import Any, TypeVar

import msgspec

from pcmrs.errors import UnknownOutcomeError

M = TypeVar("M", bound=msgspec.Struct)


class MemoryLink:
    """Implements `pcmrs.devices.link.Link`; requests pass through MessagePack, and a process does not hear itself.

    Attributes:
        published: Key to messages, in order.
        silent: Nobody answers.
        lose: An event of a key is lost.
    """

    def __init__(self) -> None:
        self.published: dict[str, list[Any]] = defaultdict(list)
        self.silent = False
        self.lose: Callable[[str], None] = lambda _: None
        self._subscribers: dict[str, list[Callable[[str, Any], None]]] = defaultdict(list)
        self._services: dict[str, tuple[type[Any], Callable[[str, Any], Awaitable[msgspec.Struct]]]] = {}

    def publish(self, key: str, message: msgspec.Struct) -> None:
        self.published[key].append(message)

    def hear(self, key: str, message: msgspec.Struct) -> None:
        """Somebody else publishes."""
        for handler in self._subscribers[key]:
            handler(key, message)

    def subscribe(self, key: str, kind: type[M], handler: Callable[[str, M], None]) -> None:
        self._subscribers[key].append(handler)

    def listen(self, key: str, kind: type[M], handler: Callable[[str, M], None]) -> None:
        self.subscribe(key, kind, handler)

    def when_lost(self, handler: Callable[[str], None]) -> None:
        self.lose = handler

    def serve(self, key: str, kind: type[M], handler: Callable[[str, M], Awaitable[msgspec.Struct]]) -> None:
        self._services[key] = (kind, handler)

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
        if self.silent or key not in self._services:
            raise UnknownOutcomeError(f"Nobody answered on {key}.")
        kind, handler = self._services[key]
        request = msgspec.msgpack.decode(msgspec.msgpack.encode(message), type=kind)
        answer = await handler(key, request)
        return msgspec.msgpack.decode(msgspec.msgpack.encode(answer), type=reply)

    def alive(self, component: str) -> None:
        """Nobody looks."""
