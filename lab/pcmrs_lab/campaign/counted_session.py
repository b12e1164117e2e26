"""A session of somebody who attacks a reachable cell, and how many of its bytes get to the daemon."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import zenoh

from pcmrs.bus.settings import open_session
from pcmrs_lab.campaign.network_impairment import NetworkImpairment
from pcmrs_lab.campaign.proxy import tcp_proxy
from pcmrs_lab.campaign.reachable import ReachableCell
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.waiting import until_true

ANSWERED_WITHIN = 0.5
"""Whoever answers does so within this, s of the machine."""
ARRIVED_WITHIN = 5.0
SETTLED = 0.3
"""A link over which nothing went for so long has been opened, s of the machine."""


class CountedSession:
    """Sends what is the fault: in a sham campaign nothing, and then nothing arrives. Use `counted_session`.

    Attributes:
        zenoh: The session, for what is no fault.
    """

    def __init__(self, session: zenoh.Session, weather: NetworkImpairment) -> None:
        self.zenoh = session
        self._weather = weather
        self._before = weather.passed["towards"]
        self._sent = 0

    async def settled(self) -> None:
        """Waits until the handshake is over, and counts from then on."""
        before = -1
        while before != self._weather.passed["towards"]:
            before = self._weather.passed["towards"]
            await asyncio.sleep(SETTLED)
        self._before = before

    async def put(self, key: str, payload: bytes) -> None:
        """Puts a message, however long that takes."""
        self._sent += len(key) + len(payload)
        if not is_sham():
            block = zenoh.CongestionControl.BLOCK
            await asyncio.to_thread(self.zenoh.put, key, payload, congestion_control=block)

    async def delete(self, key: str) -> None:
        """Deletes a key."""
        self._sent += len(key)
        if not is_sham():
            await asyncio.to_thread(self.zenoh.delete, key)

    async def ask(self, key: str, payload: bytes) -> list[bytes]:
        """The answers that are no errors."""
        self._sent += len(key) + len(payload)
        if is_sham():
            return []
        replies: Any = self.zenoh.get(key, payload=payload, timeout=ANSWERED_WITHIN)
        return [each.ok.payload.to_bytes() for each in await asyncio.to_thread(list, replies) if each.ok is not None]

    async def arrived(self, most: int | None = None) -> int:
        """Bytes that have got to the daemon since the session was opened: all that was sent, and how it is wrapped.

        Args:
            most: The daemon closes the link when it has had so many; None when it takes all.

        Raises:
            Unmet: Less has arrived.
        """
        wanted = self._sent if most is None else most
        missing = f"The fault did not take place: fewer than {wanted} bytes have got to the daemon"
        await until_true(lambda: self._passed >= wanted, missing, ARRIVED_WITHIN)
        return self._passed

    @property
    def _passed(self) -> int:
        return self._weather.passed["towards"] - self._before


@asynccontextmanager
async def counted_session(open_cell: ReachableCell, name: str) -> AsyncIterator[CountedSession]:
    """A session of somebody's, over a proxy that counts. Raises `BusError` when they are not let in."""
    async with counting_endpoint(open_cell) as (endpoint, weather):
        settings = msgspec.structs.replace(open_cell.settings(name), endpoint=endpoint)
        session = await asyncio.to_thread(open_session, settings)
        try:
            counted = CountedSession(session, weather)
            await counted.settled()
            yield counted
        finally:
            await asyncio.to_thread(session.close)


@asynccontextmanager
async def counting_endpoint(open_cell: ReachableCell) -> AsyncIterator[tuple[str, NetworkImpairment]]:
    """Where somebody dials the cell by way of a proxy, and what has passed it."""
    weather = NetworkImpairment()
    async with tcp_proxy(open_cell.address, weather) as (near, proxied):
        yield f"tls/{near}:{proxied}", weather
