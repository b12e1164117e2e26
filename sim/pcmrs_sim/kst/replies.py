"""Replies to the client, some of them merged into one TCP segment or split into two."""

from __future__ import annotations

import asyncio

import numpy as np

from pcmrs.clock import Clock
from pcmrs_sim.robot_faults import RobotFaults

FRAMING_PROBABILITY = 0.1
"""Probability with which a segment is delayed to be merged, or is split."""
PAUSE = 0.002
"""Time between the halves of a split reply, and delay of a reply that may be merged, s."""
LONG_PAUSE = 0.02
"""Delay of each reply if as many as possible are merged, s."""


class Replies:
    """Sender of replies, in order, while `run` runs.

    Args:
        writer: The connection.
        faults: Division of replies into segments, and faults that suppress them.
        clock: Clock of the pauses.
        rng: Random numbers that decide which replies are merged or split.
    """

    def __init__(
        self, writer: asyncio.StreamWriter, faults: RobotFaults, clock: Clock, rng: np.random.Generator
    ) -> None:
        self._writer, self._faults, self._clock, self._rng = writer, faults, clock, rng
        self._queued = b""
        self._woken = asyncio.Event()

    def send(self, text: str) -> None:
        """Queue a reply. An empty one is ignored, and all are dropped if the link is cut or silent."""
        if text and not self._faults.cut and not self._faults.silent:
            self._queued += text.encode("ascii")
            self._woken.set()

    def flush(self) -> None:
        """Send the queued replies, if the connection is still open."""
        if not self._writer.is_closing():
            self._writer.write(self._queued)
        self._queued = b""

    async def run(self) -> None:
        """Send until cancelled."""
        while True:
            await self._woken.wait()
            self._woken.clear()
            framing = self._faults.framing
            if framing == "merged" or (framing == "mixed" and self._rng.random() < FRAMING_PROBABILITY):
                await self._clock.sleep(LONG_PAUSE if framing == "merged" else PAUSE)
            if framing == "split" or (framing == "mixed" and self._rng.random() < FRAMING_PROBABILITY):
                split = int(self._rng.integers(1, max(2, len(self._queued))))
                self._writer.write(self._queued[:split])
                self._queued = self._queued[split:]
                await self._clock.sleep(PAUSE)
            self.flush()
