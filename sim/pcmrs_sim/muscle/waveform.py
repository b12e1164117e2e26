"""Shapes of what a pulse adds to the electromyogram.

What an electromyogram shows without any pulse: noise, hum of the mains, and the muscle's own activity.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pcmrs.spatial import Floats

SECOND_ORDER = 0.3
"""Part of the second order in a motor evoked potential: two unequal phases and a small third."""

REACH = 3.0
"""Scales before and after the middle of a motor evoked potential beyond which nothing is left of it (below 0.2 %)."""


def evoked_potential(since_onset: Floats, scale: float) -> Floats:
    """A motor evoked potential with a peak-to-peak amplitude of 1, at times (n,) since its onset, s.

    The sum of the Hermite-Rodriguez functions of first and second order, by which surface potentials of muscles are
    described: Lo Conte, Merletti, Sandri, Hermite expansions of compact support waveforms: applications to myoelectric
    signals, IEEE Trans. Biomed. Eng. 41 (1994) 1147.

    Args:
        since_onset: Times, s, (n,).
        scale: The functions' scale, s; the potential lasts six times that.
    """
    shape: Floats = _shape(since_onset / scale - REACH) / _PEAK_TO_PEAK
    return shape


def artefact(since_pulse: Floats, decay: float) -> Floats:
    """The stimulus artefact: 1 at the pulse, then decaying as an amplifier's coupling discharges; times in s, (n,)."""
    late = np.maximum(since_pulse, 0.0)
    return np.where(since_pulse >= 0.0, np.exp(-late / decay), 0.0)


def _shape(u: Floats) -> Floats:
    """``HR_n(u) = H_n(u) exp(-u^2) / sqrt(2^n n!)`` up to a common factor, of order 1 and 2."""
    first = 2.0 * u / np.sqrt(2.0)
    second = (4.0 * u**2 - 2.0) / np.sqrt(8.0)
    shape: Floats = (first + SECOND_ORDER * second) * np.exp(-(u**2))
    return np.where(np.abs(u) <= REACH, shape, 0.0)


_PEAK_TO_PEAK = float(np.ptp(_shape(np.linspace(-REACH, REACH, 6001))))


BAND = (20.0, 450.0)
"""Where the activity of a contracting muscle lies in the surface electromyogram, Hz: De Luca et al., J. Biomech. 43
(2010) 1573."""

STREAM = 2000
"""Keeps these draws apart from all others of a seed."""


class Background:
    """Signals of one subject that depend on the seed and the number of the sample only.

    They are drawn in blocks of a second, so that any stretch can be had at any time.

    Args:
        rate: Whole samples per second.
        seed: Where they come from.
    """

    def __init__(self, rate: int, seed: int) -> None:
        self._rate = rate
        self._seed = seed
        self._phase = np.random.default_rng((seed, STREAM)).uniform(0.0, 2.0 * np.pi)
        self._block = lru_cache(8)(self._draw)

    def noise(self, first: int, count: int) -> Floats:
        """White noise with a standard deviation of 1: samples (count,) from number `first` on."""
        return self._stretch(0, first, count)

    def activity(self, first: int, count: int) -> Floats:
        """Activity of a contracting muscle with a standard deviation of 1, likewise."""
        return self._stretch(1, first, count)

    def hum(self, first: int, count: int, hertz: float) -> Floats:
        """Hum of the mains with an amplitude of 1, likewise."""
        times = np.arange(first, first + count) / self._rate
        return np.sin(2.0 * np.pi * hertz * times + self._phase)

    def _stretch(self, row: int, first: int, count: int) -> Floats:
        blocks = range(first // self._rate, (first + count - 1) // self._rate + 1)
        joined = np.concatenate([self._block(number)[row] for number in blocks])
        offset = first - blocks.start * self._rate
        return joined[offset : offset + count]

    def _draw(self, number: int) -> tuple[Floats, Floats]:
        """Noise and activity of one second."""
        rng = np.random.default_rng((self._seed, STREAM, number))
        noise, drive = rng.normal(size=(2, self._rate))
        spectrum = np.fft.rfft(drive)
        frequencies = np.fft.rfftfreq(self._rate, 1.0 / self._rate)
        spectrum[(frequencies < BAND[0]) | (frequencies > BAND[1])] = 0.0
        activity = np.fft.irfft(spectrum, self._rate)
        return noise, activity / activity.std()
