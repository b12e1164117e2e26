"""The hot-spot by mapping a grid: every place in order, then every heading at the middle of the map.

The middle is the centre of gravity, the mean place weighted by the amplitudes there (Wassermann et al.,
Electroencephalogr. Clin. Neurophysiol. 85 (1992) 1); that of the headings likewise.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcmrs.spatial import Floats, Transform
from pcmrs.tms.scalp import ScalpPatch, as_message, as_transform
from pcmrs.tms.settings import Hotspot, MapPulse


def total(chart: ScalpPatch) -> int:
    """Pulses of a whole map."""
    return chart.settings.pulses_per_place * (len(chart.places) + len(chart.headings))


def proposal(chart: ScalpPatch, pulses: Sequence[MapPulse]) -> Transform:
    """The pose that is next: a place with the handle as at the centre, or the middle of the map with its turned."""
    index = len(pulses) // chart.settings.pulses_per_place
    if index < len(chart.places):
        return chart.places[index]
    position, _ = _middle_of_places(chart, pulses)
    return chart.pose(position, float(chart.headings[(index - len(chart.places)) % len(chart.headings)]))


def estimate(chart: ScalpPatch, pulses: Sequence[MapPulse]) -> Hotspot:
    """The middle of what is mapped; its uncertainty counts the scatter of the amplitudes, not what is not mapped."""
    position, uncertainty = _middle_of_places(chart, pulses)
    turning = pulses[_spatial(chart) :]
    angles = np.array([[chart.located(as_transform(pulse.image_from_coil))[1]] for pulse in turning])
    weights = _weights(chart, turning)
    if not weights.any():
        return Hotspot(as_message(chart.pose(position, 0.0)), uncertainty)
    angle, spread = _weighted_mean(angles, weights)
    return Hotspot(as_message(chart.pose(position, float(angle[0]))), uncertainty, spread)


def _spatial(chart: ScalpPatch) -> int:
    """Pulses over the places."""
    return chart.settings.pulses_per_place * len(chart.places)


def _middle_of_places(chart: ScalpPatch, pulses: Sequence[MapPulse]) -> tuple[Floats, float]:
    mapped = pulses[: _spatial(chart)]
    weights = _weights(chart, mapped)
    if not weights.any():
        return chart.positions[0], float(np.linalg.norm(chart.positions - chart.positions[0], axis=1).max())
    return _weighted_mean(np.array([pulse.image_from_coil.position for pulse in mapped]), weights)


def _weights(chart: ScalpPatch, pulses: Sequence[MapPulse]) -> Floats:
    """Amplitudes, V, (N,); what is no response weighs nothing."""
    amplitudes = np.array([pulse.amplitude for pulse in pulses])
    return np.where(amplitudes >= chart.settings.response_uv * 1e-6, amplitudes, 0.0)


def _weighted_mean(values: Floats, weights: Floats) -> tuple[Floats, float]:
    """The mean of values (N, D), (D,), and its standard error.

    That of a ratio whose weights scatter as much as they weigh (W. G. Cochran, Sampling Techniques, 1977, 2.11).
    """
    mean: Floats = weights @ values / weights.sum()
    scatter = np.sum((weights[:, None] * (values - mean)) ** 2)
    return mean, float(np.sqrt(scatter) / weights.sum())
