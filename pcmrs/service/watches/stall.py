"""Watch of the event loop's delay: a timer of the loop measures it, and a thread logs a stall while it lasts."""

from __future__ import annotations

import asyncio
import sys
import threading
import traceback
from collections.abc import Callable
from pathlib import Path

import structlog

from pcmrs.clock import Clock
from pcmrs.messages import DeviceEvent

log = structlog.get_logger(__name__)

PERIOD = 0.05
"""Period of the timer, and of the thread's looks at it, s of the machine."""

STALL = 0.2
"""Delay from which the loop counts as stalled, s of the machine."""

PATIENCE = 5.0
"""Length of a stall after which it is logged again, s of the machine."""

FRAMES = 6
"""Number of stack frames of the loop that are logged."""


class StallWatch:
    """Watch over the event loop: logs a stall, and reports its length when it has ended.

    The report is no danger event: if the stall is longer than the deadman, the nodes hold by themselves and say so.

    Args:
        report: Takes the event, in the loop, once the stall has ended.
        clock: The machine's clock.

    Attributes:
        stalls: Number of stalls since the start.
        longest: Longest stall, s.
        lag: Delay of the timer, s.
    """

    def __init__(self, report: Callable[[DeviceEvent], None], clock: Clock) -> None:
        self.stalls = 0
        self.longest = self.lag = 0.0
        self._report, self._clock = report, clock
        self._loop = asyncio.get_running_loop()
        self._loop_thread = threading.get_ident()
        self._due = 0.0
        self._timer: asyncio.TimerHandle | None = None
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch, name="pcmrs-stall", daemon=True)

    def start(self) -> None:
        """Start the timer and the thread."""
        self._set_timer()
        self._thread.start()

    async def close(self) -> None:
        """End both."""
        self._end.set()
        if self._timer is not None:
            self._timer.cancel()
        await self._loop.run_in_executor(None, self._thread.join)

    def counters(self) -> dict[str, int]:
        """Return the number of stalls since the start."""
        return {"loop.stalls": self.stalls}

    def _set_timer(self) -> None:
        self._due = self._clock.monotonic() + PERIOD
        self._timer = self._loop.call_later(PERIOD, self._answer)

    def _watch(self) -> None:
        # It only reads: waking the loop from another thread would cost more than everything else here.
        while not self._end.wait(PERIOD):
            due = self._due
            if self._clock.monotonic() - due <= STALL:
                continue
            log.error("loop_stalled", longer_than=STALL, where=self._where())
            logged = due + STALL
            while self._due == due and not self._end.wait(PERIOD):
                late = self._clock.monotonic()
                if late - logged >= PATIENCE:
                    logged = late
                    log.error("loop_stalled", longer_than=round(late - due, 1))

    def _where(self) -> str:
        """Present stack of the loop's thread, innermost frame first."""
        frame = sys._current_frames().get(self._loop_thread)
        lines = traceback.extract_stack(frame)[::-1][:FRAMES] if frame is not None else []
        return " < ".join(f"{line.name} ({Path(line.filename).name}:{line.lineno})" for line in lines)

    def _answer(self) -> None:
        self.lag = max(0.0, self._clock.monotonic() - self._due)
        self._set_timer()
        if self.lag <= STALL:
            return
        self.stalls += 1
        self.longest = max(self.longest, self.lag)
        text = f"The daemon did not answer for {self.lag:.2f} s, limit {STALL:g} s: the machine is overloaded, "
        text += "or the daemon was stopped, or something in it takes too long."
        fields = {"stall": self.lag, "limit": STALL}
        self._report(DeviceEvent(device="daemon", code="loop_stalled", text=text, fields=fields))
