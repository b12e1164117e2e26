"""Token bucket: limits a rate, and permits a burst."""

from __future__ import annotations

import threading

from pcmrs.clock import Clock


class TokenBucket:
    """A token bucket, full at first. From any thread.

    Args:
        rate_hz: Number of tokens that are added per second.
        burst: Number of tokens that it holds at most.
        clock: Clock of the machine.
    """

    def __init__(self, rate_hz: float, burst: int, clock: Clock) -> None:
        self._rate_hz = rate_hz
        self._burst = burst
        self._clock = clock
        self._tokens = float(burst)
        self._filled = clock.monotonic()
        self._lock = threading.Lock()

    @property
    def wait(self) -> float:
        """Time until the next token is available, s; 0 if there is one."""
        return max(0.0, 1.0 - self._tokens) / self._rate_hz

    def take(self) -> bool:
        """Take one token; return False if there is none."""
        with self._lock:
            now = self._clock.monotonic()
            self._tokens = min(self._burst, self._tokens + (now - self._filled) * self._rate_hz)
            self._filled = now
            if self._tokens < 1.0:
                return False
            self._tokens -= 1.0
            return True
