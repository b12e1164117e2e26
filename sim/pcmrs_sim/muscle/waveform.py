"""Waveforms of the electromyogram.

A pulse adds a motor evoked potential and an artefact. Noise, mains hum and the muscle's activity are there without one.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pcmrs.spatial import Floats

SECOND_ORDER = 0.3
"""Weight of the second order in a motor evoked potential: it gives two unequal phases and a small third one."""

REACH = 3.0
"""Half length of a motor evoked potential, in scales. Beyond it, the functions are below 0.2 % and are cut off."""


def evoked_potential(since_onset: Floats, scale: float) -> Floats:
    """Return a motor evoked potential with a peak-to-peak amplitude of 1, (n,).

    It is the sum of the Hermite-Rodriguez functions of first and second order, which describe surface potentials of
    muscles: Lo Conte, Merletti, Sandri, Hermite expansions of compact support waveforms: applications to myoelectric
    signals, IEEE Trans. Biomed. Eng. 41 (1994) 1147.

    Args:
        since_onset: Times since its onset, s, (n,).
        scale: Scale of the functions, s. The potential lasts six times as long.
    """
    shape: Floats = _shape(since_onset / scale - REACH) / _PEAK_TO_PEAK
    return shape


def artefact(since_pulse: Floats, decay: float) -> Floats:
    """Return the stimulus artefact, (n,): 1 at the pulse, then the decay of a discharging amplifier coupling.

    Args:
        since_pulse: Times since the pulse, s, (n,).
        decay: Time constant of the decay, s.
    """
    late = np.maximum(since_pulse, 0.0)
    return np.where(since_pulse >= 0.0, np.exp(-late / decay), 0.0)


def _shape(u: Floats) -> Floats:
    """Return the weighted sum of ``HR_n(u) = H_n(u) exp(-u^2) / sqrt(2^n n!)``, n = 1 and 2, up to a common factor."""
    first = 2.0 * u / np.sqrt(2.0)
    second = (4.0 * u**2 - 2.0) / np.sqrt(8.0)
    shape: Floats = (first + SECOND_ORDER * second) * np.exp(-(u**2))
    return np.where(np.abs(u) <= REACH, shape, 0.0)


_PEAK_TO_PEAK = float(np.ptp(_shape(np.linspace(-REACH, REACH, 6001))))


BAND = (20.0, 450.0)
"""Frequency band of a contracting muscle's activity in the surface electromyogram, Hz: De Luca et al., J. Biomech. 43
(2010) 1573."""

STREAM = 2000
"""Number of the random stream of these signals, so that it is independent of the other streams of a seed."""


class Background:
    """Signals of one subject that depend only on the seed and the number of the sample.

    They are drawn in blocks of one second, so that any interval can be computed at any time.

    Args:
        rate: Samples per second, an integer.
        seed: Seed of the signals.
    """

    def __init__(self, rate: int, seed: int) -> None:
        self._rate = rate
        self._seed = seed
        self._phase = np.random.default_rng((seed, STREAM)).uniform(0.0, 2.0 * np.pi)
        self._block = lru_cache(8)(self._draw)  # most requests are for the newest seconds

    def noise(self, first: int, count: int) -> Floats:
        """Return white noise with a standard deviation of 1, (count,).

        Args:
            first: Number of the first sample.
            count: Number of samples.
        """
        return self._interval(0, first, count)

    def activity(self, first: int, count: int) -> Floats:
        """Return the activity of a contracting muscle with a standard deviation of 1, (count,).

        Args:
            first: Number of the first sample.
            count: Number of samples.
        """
        return self._interval(1, first, count)

    def hum(self, first: int, count: int, hertz: float) -> Floats:
        """Return mains hum with an amplitude of 1, (count,).

        Args:
            first: Number of the first sample.
            count: Number of samples.
            hertz: Frequency of the mains, Hz.
        """
        times = np.arange(first, first + count) / self._rate
        return np.sin(2.0 * np.pi * hertz * times + self._phase)

    def _interval(self, row: int, first: int, count: int) -> Floats:
        blocks = range(first // self._rate, (first + count - 1) // self._rate + 1)
        joined = np.concatenate([self._block(number)[row] for number in blocks])
        offset = first - blocks.start * self._rate
        return joined[offset : offset + count]

    def _draw(self, number: int) -> tuple[Floats, Floats]:
        """Draw noise and activity of one second."""
        rng = np.random.default_rng((self._seed, STREAM, number))
        noise, unfiltered = rng.normal(size=(2, self._rate))
        spectrum = np.fft.rfft(unfiltered)
        frequencies = np.fft.rfftfreq(self._rate, 1.0 / self._rate)
        spectrum[(frequencies < BAND[0]) | (frequencies > BAND[1])] = 0.0
        activity = np.fft.irfft(spectrum, self._rate)
        return noise, activity / activity.std()
