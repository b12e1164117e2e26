"""Hunts for a threshold on muscles that answer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pcmrs.tms.settings import ThresholdMethod, ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs_sim.tms.recruitment import Recruitment

Answer = Callable[[float], tuple[bool, float | None]]
METHODS: tuple[ThresholdMethod, ...] = ("ml", "relative_frequency")


def hunted(settings_: ThresholdSettings, answer: Answer) -> MotorThresholdEstimator:
    """Pulses until it ends, one way or the other."""
    hunt = MotorThresholdEstimator.begin(settings_)
    while not hunt.finished and hunt.refusal is None:
        intensity = hunt.next_intensity()
        assert 1.0 <= intensity <= settings_.ceiling
        assert intensity == round(intensity)
        hunt = hunt.after(intensity, *answer(intensity))
    return hunt


def step_at(threshold: float) -> Answer:
    return lambda intensity: (intensity >= threshold, None)


def muscle(threshold: float, seed: int) -> Answer:
    subject, rng = Recruitment(threshold), np.random.default_rng(seed)

    def answer(intensity: float) -> tuple[bool, float | None]:
        amplitude = subject.sample(intensity, rng)
        return amplitude >= 50e-6, amplitude

    return answer


def yes_or_no(answer: Answer) -> Answer:
    return lambda intensity: (answer(intensity)[0], None)
