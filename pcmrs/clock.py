"""The only source of time: every wait, deadline and time stamp uses a `Clock`."""

from __future__ import annotations

import asyncio
import time
from contextlib import AbstractAsyncContextManager
from typing import Any, Protocol

__all__ = ["Clock", "SystemClock"]


class Clock(Protocol):
    """Monotonic time, wall time, and waiting."""

    def monotonic(self) -> float:
        """Return the time of a clock that is never set, s; its zero has no meaning."""

    def wall(self) -> float:
        """Return the wall time, Unix seconds.

        It is for display and records. The only decisions that use it are about the age of calibrations, certificates
        and signed messages.
        """

    async def sleep(self, seconds: float) -> None:
        """Wait `seconds` of this clock."""

    def timeout(self, seconds: float) -> AbstractAsyncContextManager[Any]:
        """Return a context that raises `TimeoutError` after `seconds` of this clock."""


class SystemClock:
    """The clock of the machine, which runs `rate` times as fast for a simulated cell.

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
