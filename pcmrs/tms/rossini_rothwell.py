"""The motor threshold by relative frequency, 5 of 10.

Rossini et al., Clin. Neurophysiol. 126 (2015) 1071: from a low intensity up in steps of 5 % until every pulse is
answered, then down in steps of 1 % until less than 5 of 10 are; the intensity before is the threshold. "Every pulse" is
three of them here, and a step ends as soon as its answer is known.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence

from pcmrs.tms.settings import Estimate, EstimatorState, Pulse, ThresholdSettings

RISE = 5
"""Percent of the maximum stimulator output, upwards."""

ANSWERED_ALL = 3
ENOUGH, OF = 5, 10

Protocol = Generator[int, bool, int]
"""Asks for intensities, is told of responses, and comes to a threshold."""


def standing(settings: ThresholdSettings, pulses: Sequence[Pulse]) -> EstimatorState:
    """What the protocol asks for after these pulses, or comes to; until then it estimates where it is."""
    protocol = _protocol(settings)
    asked = next(protocol)
    try:
        for pulse in pulses:
            asked = protocol.send(pulse.responded)
    except StopIteration as end:
        threshold = float(end.value)
    else:
        return EstimatorState(Estimate(float(asked)), float(asked))
    refusal = None
    if threshold > settings.ceiling:
        refusal = "above_ceiling"
    elif threshold <= settings.floor:
        refusal = "below_floor"
    return EstimatorState(
        Estimate(threshold), min(threshold, settings.ceiling), finished=refusal is None, refusal=refusal
    )


def _protocol(settings: ThresholdSettings) -> Protocol:
    ceiling = math.floor(settings.ceiling)
    intensity = min(round(settings.start), ceiling)
    while not (yield from _all_answered(intensity)) and intensity < ceiling:
        intensity = min(intensity + RISE, ceiling)
    while intensity >= settings.floor and (yield from _half_answered(intensity)):
        intensity -= 1
    return intensity + 1


def _all_answered(intensity: int) -> Generator[int, bool, bool]:
    for _ in range(ANSWERED_ALL):
        if not (yield intensity):
            return False
    return True


def _half_answered(intensity: int) -> Generator[int, bool, bool]:
    answered = missed = 0
    while answered < ENOUGH and missed <= OF - ENOUGH:
        if (yield intensity):
            answered += 1
        else:
            missed += 1
    return answered == ENOUGH
