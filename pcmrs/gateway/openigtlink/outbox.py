"""What one peer is still to be sent, bounded, so that one that does not read holds up nobody."""

from __future__ import annotations

import asyncio
from collections import deque

from pcmrs.clock import Clock

MAX_WAITING = 100
"""Messages other than poses that wait; beyond that the oldest is dropped."""
STALLED_AFTER = 10.0
"""A peer that has taken nothing for so long is given up, s."""


class Outbox:
    """Keeps of each pose the newest, and of all else the newest `MAX_WAITING`, in order.

    Attributes:
        dropped: Messages that gave way to newer ones.
    """

    def __init__(self) -> None:
        self.dropped = 0
        self._poses: dict[str, bytes] = {}
        self._rest: deque[bytes] = deque()
        self._filled = asyncio.Event()

    def put_pose(self, name: str, data: bytes) -> None:
        """Replaces the pose of that name, if it still waits."""
        self.dropped += name in self._poses
        self._poses[name] = data
        self._filled.set()

    def put(self, data: bytes) -> None:
        """Adds a message that is not replaced by later ones of its kind."""
        if len(self._rest) == MAX_WAITING:
            self._rest.popleft()
            self.dropped += 1
        self._rest.append(data)
        self._filled.set()

    async def send(self, writer: asyncio.StreamWriter, clock: Clock) -> None:
        """Sends until cancelled, no faster than the peer reads.

        Raises:
            TimeoutError: The peer has taken nothing for `STALLED_AFTER`.
            ConnectionError: It is gone.
        """
        # Nothing waits in the transport, where it could be neither counted nor replaced.
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
