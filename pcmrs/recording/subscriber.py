"""Subscriber to a cell that stores payloads undecoded, with their time of arrival."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from pcmrs.bus import BusSettings
from pcmrs.bus.codec import pack
from pcmrs.bus.declare import declare_publisher, declare_subscriber
from pcmrs.bus.handshake import RUN, Handshake
from pcmrs.bus.keys import cell_prefix
from pcmrs.bus.qos import class_of
from pcmrs.bus.seal import Seal
from pcmrs.bus.serving import payload_of
from pcmrs.bus.settings import open_session
from pcmrs.clock import Clock
from pcmrs.messages import DeviceEvent

if TYPE_CHECKING:
    import zenoh

CAPACITY: Final = 20_000
"""Largest number of messages that wait to be written: many seconds of a cell at work."""

EVENTS: Final = "daemon/event"


@dataclass(frozen=True, slots=True)
class RawSample:
    """One message.

    Attributes:
        key: Key, relative to the cell.
        payload: Payload on the bus.
        at: Time of arrival, s of the machine's monotonic clock.
    """

    key: str
    payload: bytes
    at: float


class Subscriber:
    """Queue of messages on some keys of a cell; when it is full, new ones are dropped and counted.

    Use `Subscriber.open`.

    Attributes:
        prefix: Key prefix of the cell.
        dropped: Number of messages that arrived while the queue was full.
    """

    def __init__(self, session: zenoh.Session, prefix: str, clock: Clock, seal: Seal | None = None) -> None:
        self.prefix = prefix
        self.dropped = 0
        self._session = session
        self._clock = clock
        self._seal = seal
        self._waiting: deque[RawSample] = deque()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="pcmrs-tap")
        self._declared: list[Any] = []

    @classmethod
    async def open(
        cls, settings: BusSettings, topics: Sequence[str], clock: Clock, seal: Seal | None = None
    ) -> Subscriber:
        """Connect to the bus and subscribe.

        Args:
            settings: Settings of the bus.
            topics: Key expressions, relative to the cell, that do not overlap.
            clock: Clock of the machine.
            seal: Seal with the key of daemon and nodes, which allows reports to the daemon; None without the key.

        Raises:
            BusError: No daemon answers at the endpoint.
            PayloadError: The site's or cell's name cannot be a part of a key.
        """
        prefix = cell_prefix(settings.site, settings.cell)
        session = await asyncio.get_running_loop().run_in_executor(None, open_session, settings)
        subscriber = cls(session, prefix, clock, seal)
        for topic in topics:
            handle = declare_subscriber(session, f"{prefix}/{topic}", class_of(topic), subscriber._receive)
            subscriber._declared.append(handle)
        return subscriber

    def take(self) -> list[RawSample]:
        """Take the messages that arrived since the last call, in order."""
        return [self._waiting.popleft() for _ in range(len(self._waiting))]

    async def report(self, event: DeviceEvent) -> None:
        """Report an event to the daemon, which journals it; without the key this does nothing.

        The daemon is asked for its run first: it accepts no report that does not name it.
        """
        if self._seal is None:
            return
        await Handshake(self._session, f"{self.prefix}/{RUN}", self._seal, self._pool, lambda *_: None).ended()
        key, payload = f"{self.prefix}/{EVENTS}", pack(event)
        publisher = declare_publisher(self._session, key, class_of(EVENTS))
        self._declared.append(publisher)
        await self._in_pool(partial(publisher.put, payload, attachment=self._seal.put("put", key, payload)))

    async def close(self) -> None:
        """Disconnect from the bus."""
        await self._in_pool(self._undeclare)
        await self._in_pool(self._session.close)
        self._pool.shutdown()

    def _receive(self, sample: zenoh.Sample) -> None:
        """Queue a message. Zenoh calls it in its threads."""
        at = self._clock.monotonic()
        if len(self._waiting) >= CAPACITY:
            self.dropped += 1
            return
        key = str(sample.key_expr).removeprefix(f"{self.prefix}/")
        self._waiting.append(RawSample(key, payload_of(sample), at))

    def _undeclare(self) -> None:
        for entity in self._declared:
            entity.undeclare()

    async def _in_pool(self, work: Any) -> None:
        await asyncio.get_running_loop().run_in_executor(self._pool, work)
