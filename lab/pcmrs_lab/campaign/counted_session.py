"""Session of an attacker at a reachable cell, which counts the bytes that reach the daemon."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import msgspec
import zenoh

from pcmrs.bus.settings import open_session
from pcmrs.testing.proxy import tcp_proxy
from pcmrs_lab.campaign.network_impairment import InjectedImpairment
from pcmrs_lab.campaign.reachable import ReachableCell, attacker_of
from pcmrs_lab.campaign.sham import is_sham
from pcmrs_lab.campaign.tries import record, way_of
from pcmrs_lab.campaign.waiting import until_true

ANSWERED_WITHIN = 0.5
"""Time in which a component that answers at all has answered, s of the machine."""
ARRIVED_WITHIN = 5.0
"""Time limit for the bytes to reach the daemon, s of the machine."""
SETTLED = 0.3
"""A link without traffic for this time has completed its handshake, s of the machine."""


class CountedSession:
    """Session whose messages are the fault. It records what it tries, and sends nothing in a sham campaign.

    Use `counted_session`.

    Attributes:
        zenoh: Session for messages that are not part of the fault.
    """

    def __init__(self, session: zenoh.Session, impairment: InjectedImpairment, attacker: str) -> None:
        self.zenoh = session
        self._impairment = impairment
        self._attacker = attacker
        self._before = impairment.passed["towards"]
        self._sent = 0

    async def wait_for_handshake(self) -> None:
        """Wait until the handshake has ended, and count from then on."""
        before = -1
        while before != self._impairment.passed["towards"]:
            before = self._impairment.passed["towards"]
            await asyncio.sleep(SETTLED)
        self._before = before

    async def put(self, key: str, payload: bytes, attachment: bytes | None = None) -> None:
        """Put a message, and block until it is sent.

        Args:
            key: Zenoh key.
            payload: Bytes of the message.
            attachment: Signature or seal of the message; None for none.
        """
        self._note(key, len(payload))
        if not is_sham():
            block = zenoh.CongestionControl.BLOCK
            await asyncio.to_thread(self.zenoh.put, key, payload, congestion_control=block, attachment=attachment)

    async def delete(self, key: str) -> None:
        """Delete a key."""
        self._note(key)
        if not is_sham():
            await asyncio.to_thread(self.zenoh.delete, key)

    async def ask(self, key: str, payload: bytes, attachment: bytes | None = None) -> list[bytes]:
        """Query a key and return the answers without the errors.

        Args:
            key: Zenoh key.
            payload: Bytes of the query.
            attachment: Signature or seal of the query; None for none.
        """
        self._note(key, len(payload))
        if is_sham():
            return []
        replies: Any = self.zenoh.get(key, payload=payload, attachment=attachment, timeout=ANSWERED_WITHIN)
        return [each.ok.payload.to_bytes() for each in await asyncio.to_thread(list, replies) if each.ok is not None]

    async def wait_until_arrived(self, most: int | None = None) -> int:
        """Wait until all sent bytes have reached the daemon; return their number, with the protocol's overhead.

        Args:
            most: Number of bytes after which the daemon closes the link; None if it accepts all.

        Raises:
            Unmet: Fewer bytes have arrived.
        """
        wanted = self._sent if most is None else most
        missing = f"The fault was not injected: fewer than {wanted} bytes reached the daemon"
        await until_true(lambda: self._passed >= wanted, missing, ARRIVED_WITHIN)
        return self._passed

    def _note(self, key: str, length: int = 0) -> None:
        self._sent += len(key) + length
        record(self._attacker, way_of(key))

    @property
    def _passed(self) -> int:
        return self._impairment.passed["towards"] - self._before


@asynccontextmanager
async def counted_session(open_cell: ReachableCell, name: str) -> AsyncIterator[CountedSession]:
    """Open the session of a user over a proxy that counts bytes.

    Args:
        open_cell: Cell that is reachable over TLS.
        name: User, a key of `PEOPLE` or a name beside it.

    Yields:
        Session after its handshake.

    Raises:
        BusError: The user is not admitted.
    """
    async with counting_endpoint(open_cell) as (endpoint, impairment):
        settings = msgspec.structs.replace(open_cell.settings(name), endpoint=endpoint)
        session = await asyncio.to_thread(open_session, settings)
        try:
            counted = CountedSession(session, impairment, attacker_of(name))
            await counted.wait_for_handshake()
            yield counted
        finally:
            await asyncio.to_thread(session.close)


@asynccontextmanager
async def counting_endpoint(open_cell: ReachableCell) -> AsyncIterator[tuple[str, InjectedImpairment]]:
    """Start a counting proxy in front of a cell; yield the endpoint of the proxy and its counters."""
    impairment = InjectedImpairment()
    async with tcp_proxy(open_cell.address, impairment) as (near, proxied):
        yield f"tls/{near}:{proxied}", impairment
