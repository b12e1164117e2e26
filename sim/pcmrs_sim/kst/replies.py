"""Replies on their way to the client: now and then two in one segment, or one in two."""

from __future__ import annotations

import asyncio

import numpy as np

from pcmrs.clock import Clock
from pcmrs_sim.robot_faults import RobotFaults

SELDOM = 0.1
"""Probability with which a segment is held back to be merged, or is split."""
PAUSE = 0.002
"""Between the halves of a split reply, and as long a reply is held back, s."""
LONG_PAUSE = 0.02
"""As long a reply is held back when all are to be merged, s."""


class Replies:
    """Sends in order; ``run`` must be running.

    Args:
        writer: The connection.
        faults: How replies lie in segments, and whether they go out at all.
        clock: For the pauses.
        rng: When replies are merged or split.
    """

    def __init__(
        self, writer: asyncio.StreamWriter, faults: RobotFaults, clock: Clock, rng: np.random.Generator
    ) -> None:
        self._writer, self._faults, self._clock, self._rng = writer, faults, clock, rng
        self._waiting = b""
        self._woken = asyncio.Event()

    def send(self, text: str) -> None:
        """Takes a reply; an empty one is none, and none goes out over a dead link."""
        if text and not self._faults.cut and not self._faults.silent:
            self._waiting += text.encode("ascii")
            self._woken.set()

    def flush(self) -> None:
        """Sends what waits, as far as there is still a connection."""
        if not self._writer.is_closing():
            self._writer.write(self._waiting)
        self._waiting = b""

    async def run(self) -> None:
        """Sends until cancelled."""
        while True:
            await self._woken.wait()
            self._woken.clear()
            framing = self._faults.framing
            if framing == "merged" or (framing == "mixed" and self._rng.random() < SELDOM):
                await self._clock.sleep(LONG_PAUSE if framing == "merged" else PAUSE)
            if framing == "split" or (framing == "mixed" and self._rng.random() < SELDOM):
                part = int(self._rng.integers(1, max(2, len(self._waiting))))
                self._writer.write(self._waiting[:part])
                self._waiting = self._waiting[part:]
                await self._clock.sleep(PAUSE)
            self.flush()
