"""Hot-spot by mapping a grid: every place in order, then every heading at the middle of the map.

The middle is the centre of gravity, which is the mean place weighted by the amplitudes (Wassermann et al.,
Electroencephalogr. Clin. Neurophysiol. 85 (1992) 1). The best heading is the mean heading with such weights.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pcmrs.spatial import Floats, Transform
from pcmrs.tms.scalp import ScalpPatch, as_message, as_transform
from pcmrs.tms.settings import Hotspot, MapPulse


def pulse_count(patch: ScalpPatch) -> int:
    """Return the number of pulses of a whole map."""
    return patch.settings.pulses_per_place * (len(patch.places) + len(patch.headings))


def next_pose(patch: ScalpPatch, pulses: Sequence[MapPulse]) -> Transform:
    """Return the pose of the next pulse: a place with the centre's heading, or a heading at the middle of the map.

    Args:
        patch: Places and headings of the search.
        pulses: Pulses so far.
    """
    index = len(pulses) // patch.settings.pulses_per_place
    if index < len(patch.places):
        return patch.places[index]
    position, _ = _middle_of_places(patch, pulses)
    return patch.pose_at(position, float(patch.headings[(index - len(patch.places)) % len(patch.headings)]))


def estimate(patch: ScalpPatch, pulses: Sequence[MapPulse]) -> Hotspot:
    """Return the middle of the map and its uncertainty.

    The uncertainty covers the scatter of the amplitudes, but not unmapped places.

    Args:
        patch: Places and headings of the search.
        pulses: Pulses so far.
    """
    position, uncertainty = _middle_of_places(patch, pulses)
    headed = pulses[_place_pulses(patch) :]
    angles = np.array([[patch.locate(as_transform(pulse.image_from_coil))[1]] for pulse in headed])
    weights = _weights(patch, headed)
    if not weights.any():
        return Hotspot(as_message(patch.pose_at(position, 0.0)), uncertainty)
    angle, spread = _weighted_mean(angles, weights)
    return Hotspot(as_message(patch.pose_at(position, float(angle[0]))), uncertainty, spread)


def _place_pulses(patch: ScalpPatch) -> int:
    """Return the number of pulses over the places, before those over the headings."""
    return patch.settings.pulses_per_place * len(patch.places)


def _middle_of_places(patch: ScalpPatch, pulses: Sequence[MapPulse]) -> tuple[Floats, float]:
    mapped = pulses[: _place_pulses(patch)]
    weights = _weights(patch, mapped)
    if not weights.any():
        return patch.positions[0], float(np.linalg.norm(patch.positions - patch.positions[0], axis=1).max())
    return _weighted_mean(np.array([pulse.image_from_coil.position for pulse in mapped]), weights)


def _weights(patch: ScalpPatch, pulses: Sequence[MapPulse]) -> Floats:
    """Return the amplitudes, V, (N,), with 0 for pulses without a response."""
    amplitudes = np.array([pulse.amplitude for pulse in pulses])
    return np.where(amplitudes >= patch.settings.response_uv * 1e-6, amplitudes, 0.0)


def _weighted_mean(values: Floats, weights: Floats) -> tuple[Floats, float]:
    """Return the weighted mean of values (N, D), (D,), and its standard error.

    The standard error is that of a ratio with random weights (W. G. Cochran, Sampling Techniques, 1977, 2.11).
    """
    mean: Floats = weights @ values / weights.sum()
    scatter = np.sum((weights[:, None] * (values - mean)) ** 2)
    return mean, float(np.sqrt(scatter) / weights.sum())
