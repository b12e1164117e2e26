"""The one source of time: every wait, deadline and stamp goes through a `Clock`."""

from __future__ import annotations

import asyncio
import time
from contextlib import AbstractAsyncContextManager
from typing import Any, Protocol


class Clock(Protocol):
    """Seconds that never jump, the wall's seconds, and waiting."""

    def monotonic(self) -> float:
        """Seconds on a clock that is never set; its zero has no meaning."""

    def wall(self) -> float:
        """Unix seconds, for display and records; decides only if a calibration or a signature is too old."""

    async def sleep(self, seconds: float) -> None:
        """Waits `seconds` of this clock."""

    def timeout(self, seconds: float) -> AbstractAsyncContextManager[Any]:
        """A context that raises `TimeoutError` after `seconds` of this clock."""


class SystemClock:
    """The machine's clock, run `rate` times as fast for a simulated cell.

    All processes of one machine that use the same rate share the same monotonic time.

    Args:
        rate: Seconds of this clock per second of the machine; 1 with real devices.
    """

    def __init__(self, rate: float = 1.0) -> None:
        self.rate = rate

    def monotonic(self) -> float:
        return time.monotonic() * self.rate

    def wall(self) -> float:
        return time.time()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(max(0.0, seconds) / self.rate)

    def timeout(self, seconds: float) -> AbstractAsyncContextManager[Any]:
        return asyncio.timeout(seconds / self.rate)
