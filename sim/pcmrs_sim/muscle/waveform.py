"""Shapes of what a pulse adds to the electromyogram."""

from __future__ import annotations

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
