"""Bounded queue of messages to one peer, so that a peer that does not read delays nobody."""

from __future__ import annotations

import asyncio
from collections import deque

from pcmrs.clock import Clock

MAX_WAITING = 100
"""Limit of waiting messages other than poses; beyond it the oldest is dropped."""
STALLED_AFTER = 10.0
"""Limit after which a peer that reads nothing is disconnected, s."""


class Outbox:
    """Queue of the newest message of each pose, and of the newest `MAX_WAITING` other messages, in order.

    Attributes:
        dropped: Number of messages that newer ones have replaced.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._poses: dict[str, bytes] = {}
        self._rest: deque[bytes] = deque()
        self._filled = asyncio.Event()

    def put_pose(self, name: str, data: bytes) -> None:
        """Add a pose, in place of one of the same name that still waits.

        Args:
            name: Name of the pose.
            data: The packed message.
        """
        self.dropped += name in self._poses
        self._poses[name] = data
        self._filled.set()

    def put(self, data: bytes) -> None:
        """Add a message that later ones do not replace."""
        if len(self._rest) == MAX_WAITING:
            self._rest.popleft()
            self.dropped += 1
        self._rest.append(data)
        self._filled.set()

    async def send(self, writer: asyncio.StreamWriter, clock: Clock) -> None:
        """Send until cancelled, no faster than the peer reads.

        Args:
            writer: Connection to the peer.
            clock: The machine's clock.

        Raises:
            TimeoutError: The peer has read nothing for `STALLED_AFTER`.
            ConnectionError: The peer is gone.
        """
        # No message waits in the transport, where it could be neither counted nor replaced.
        writer.transport.set_write_buffer_limits(high=0)
        while True:
            await self._filled.wait()
            writer.write(self._take())
            async with clock.timeout(STALLED_AFTER):
                await writer.drain()

    def _take(self) -> bytes:
        data = b"".join([*self._rest, *self._poses.values()])
        self._rest.clear()
        self._poses.clear()
        self._filled.clear()
        return data
