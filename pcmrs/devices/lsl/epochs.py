"""A recording of one channel that keeps the newest seconds, and the epochs cut from it."""

from __future__ import annotations

import numpy as np

from pcmrs.errors import DeviceError
from pcmrs.spatial import Floats

LONGEST = 5.0
"""Of an epoch before its pulse, and after it, s."""


def check_window(before: float, after: float) -> None:
    """Checks how long an epoch is to last before and after its pulse, s.

    Raises:
        DeviceError: One is negative, too long or no number.
    """
    if not (0.0 <= before <= LONGEST and 0.0 <= after <= LONGEST):
        raise DeviceError(
            f"An epoch from {before:g} s before its pulse until {after:g} s after it cannot be had; both go from 0 to "
            f"{LONGEST:g} s.",
            before=before,
            after=after,
        )


class SampleBuffer:
    """The newest samples of one channel with their times.

    Args:
        rate: Samples per second.
        seconds: How much is kept.
        jitter: Greatest distance of a sample's time from an even spacing, s; more means that samples are missing.
    """

    def __init__(self, rate: float, seconds: float, jitter: float) -> None:
        self.rate = rate
        self._jitter = jitter
        self._times = np.empty(0)
        self._samples = np.empty(0)
        self._length = int(rate * seconds)

    @property
    def end(self) -> float:
        """Time of the newest sample, s; before everything when there is none."""
        return float(self._times[-1]) if self._times.size else -np.inf

    def add(self, times: Floats, samples: Floats) -> None:
        """Appends samples (n,) with their times, s, (n,)."""
        self._times = np.concatenate((self._times, times))[-self._length :]
        self._samples = np.concatenate((self._samples, samples))[-self._length :]

    def cut(self, start: float, end: float) -> tuple[float, Floats]:
        """The samples from `start` to `end`, s, and the time of the first of them.

        The times of devices that stamp whole packets jump; the line through all times of the epoch does so less than
        any one of them.

        Raises:
            DeviceError: Samples of that time are missing.
        """
        within = np.flatnonzero((self._times >= start) & (self._times <= end))
        whole = slice(within[0], within[-1] + 1) if within.size else slice(0)
        times, samples = self._times[whole], self._samples[whole]
        steps = np.arange(times.size) / self.rate
        first = float(np.mean(times - steps)) if times.size else start
        uneven = float(np.abs(times - steps - first).max(initial=0.0))
        missing = (end - start) * self.rate - times.size
        if uneven > self._jitter or missing > 1 + 2 * self._jitter * self.rate:
            raise DeviceError(
                f"Samples of the epoch are missing: it has {times.size} of {(end - start) * self.rate:.0f}, and their "
                f"times are up to {uneven * 1e3:.1f} ms off an even spacing; {self._jitter * 1e3:g} ms are allowed. "
                "Give the pulse again; look at the amplifier and the network if it happens again.",
                samples=int(times.size),
                uneven=uneven,
                limit=self._jitter,
            )
        return first, samples
