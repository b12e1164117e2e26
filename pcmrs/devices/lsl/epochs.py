"""Buffer of the newest seconds of one channel, and the epochs cut from it."""

from __future__ import annotations

import numpy as np

from pcmrs.errors import DeviceError
from pcmrs.spatial import Floats

LONGEST = 5.0
"""Longest duration of an epoch before its pulse, and after it, s."""


def check_window(before: float, after: float) -> None:
    """Check the durations of an epoch.

    Args:
        before: Duration before the pulse, s.
        after: Duration after the pulse, s.

    Raises:
        DeviceError: A duration is negative, longer than `LONGEST` or not a number.
    """
    if not (0.0 <= before <= LONGEST and 0.0 <= after <= LONGEST):
        raise DeviceError(
            f"An epoch from {before:g} s before its pulse until {after:g} s after it is not possible; the range of "
            f"both is 0 to {LONGEST:g} s.",
            before=before,
            after=after,
        )


class SignalBuffer:
    """The newest samples of one channel with their times.

    Args:
        rate: Samples per second.
        seconds: Duration that is stored, s.
        jitter: Greatest deviation of a sample's time from an even spacing, s; more means that samples are missing.
    """

    def __init__(self, rate: float, seconds: float, jitter: float) -> None:
        self.rate = rate
        self._jitter = jitter
        self._times = np.empty(0)
        self._samples = np.empty(0)
        self._length = int(rate * seconds)

    @property
    def end(self) -> float:
        """Time of the newest sample, s; minus infinity if there is none."""
        return float(self._times[-1]) if self._times.size else -np.inf

    def add(self, times: Floats, samples: Floats) -> None:
        """Append samples.

        Args:
            times: Times of the samples, s, (n,).
            samples: Values of the samples, (n,).
        """
        self._times = np.concatenate((self._times, times))[-self._length :]
        self._samples = np.concatenate((self._samples, samples))[-self._length :]

    def cut(self, start: float, end: float) -> tuple[float, Floats]:
        """Return the time of the first sample of an epoch, s, and its samples, (n,).

        The time stamps of devices that stamp whole packets jump. The time of the first sample is therefore taken from a
        line through all time stamps of the epoch.

        Args:
            start: Start of the epoch, s.
            end: End of the epoch, s.

        Raises:
            DeviceError: Samples of the epoch are missing.
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
