"""What an electromyogram shows without any pulse: noise, hum of the mains, and the muscle's own activity."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from pcmrs.spatial import Floats

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
