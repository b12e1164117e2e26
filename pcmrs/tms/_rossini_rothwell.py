"""Motor threshold by relative frequency, 5 of 10 (Rossini-Rothwell).

Rossini et al., Clin. Neurophysiol. 126 (2015) 1071: the intensity rises from a low value in steps of 5 % until every
pulse evokes a response, then it falls in steps of 1 % until fewer than 5 of 10 do. The threshold is the previous
intensity. "Every pulse" means three pulses here, and a step ends as soon as its result is known.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence

from pcmrs.tms.settings import Estimate, EstimatorState, Pulse, ThresholdSettings

RISE = 5
"""Step upwards, percent of the maximum stimulator output."""

ALL_RESPONSES = 3
"""Number of pulses that must all evoke a response before the intensity falls."""

MIN_RESPONSES, TRIALS = 5, 10
"""Number of responses, and of pulses, that define the threshold."""

_Protocol = Generator[int, bool, int]
"""Generator that yields intensities, receives responses, and returns a threshold."""


def estimator_state(settings: ThresholdSettings, pulses: Sequence[Pulse]) -> EstimatorState:
    """Return the next intensity of the protocol after some pulses, or its threshold.

    Until the threshold is known, the next intensity is the estimate.

    Args:
        settings: Settings of the threshold hunt.
        pulses: Pulses so far.
    """
    protocol = _protocol(settings)
    intensity = next(protocol)
    try:
        for pulse in pulses:
            intensity = protocol.send(pulse.responded)
    except StopIteration as end:
        threshold = float(end.value)
    else:
        return EstimatorState(Estimate(float(intensity)), float(intensity))
    refusal = None
    if threshold > settings.ceiling:
        refusal = "above_ceiling"
    elif threshold <= settings.floor:
        refusal = "below_floor"
    return EstimatorState(
        Estimate(threshold), min(threshold, settings.ceiling), finished=refusal is None, refusal=refusal
    )


def _protocol(settings: ThresholdSettings) -> _Protocol:
    ceiling = math.floor(settings.ceiling)
    intensity = min(round(settings.start), ceiling)
    while not (yield from _all_responded(intensity)) and intensity < ceiling:
        intensity = min(intensity + RISE, ceiling)
    # At the ceiling a muscle that does not always respond may still respond to half of the pulses.
    while intensity >= settings.floor and (yield from _half_responded(intensity)):
        intensity -= 1
    # The last intensity was too low, or reached the floor.
    return intensity + 1


def _all_responded(intensity: int) -> Generator[int, bool, bool]:
    for _ in range(ALL_RESPONSES):
        if not (yield intensity):
            return False
    return True


def _half_responded(intensity: int) -> Generator[int, bool, bool]:
    responses = missed = 0
    while responses < MIN_RESPONSES and missed <= TRIALS - MIN_RESPONSES:
        if (yield intensity):
            responses += 1
        else:
            missed += 1
    return responses == MIN_RESPONSES
