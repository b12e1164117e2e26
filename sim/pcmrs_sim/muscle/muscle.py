"""The electromyogram of one subject: every sample of it, whoever asks and whenever."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from pcmrs.spatial import Floats, Transform
from pcmrs_sim.muscle.waveform import Background, artefact, evoked_potential
from pcmrs_sim.settings import MuscleSettings

KEPT = 256
"""Pulses that are remembered."""
EFFECT = 0.25
"""Seconds after which nothing is left of a pulse."""
STREAM = 2001
"""Keeps these draws apart from all others of a seed."""


class Responder(Protocol):
    """What is asked of a subject; `pcmrs_sim.tms.subject.Subject` is one."""

    def response(self, image_from_coil: Transform, intensity: float, rng: np.random.Generator) -> float:
        """Peak-to-peak amplitude of the response, V."""


@dataclass(frozen=True)
class Stimulus:
    """A pulse as the muscle felt it.

    Attributes:
        number: Of the pulse.
        time: Of the cell's clock, s.
        intensity: Percent of the maximum stimulator output.
        amplitude: Of the response, peak to peak, V.
    """

    number: int
    time: float
    intensity: float
    amplitude: float


class Muscle:
    """A relaxed muscle of the hand, its electrodes and their amplifier.

    Sample number n belongs to the time n / rate of the cell's clock. Nothing here lowers the threshold of a muscle that
    is active, as a real one's is.

    Args:
        settings: Its electromyogram.
        draw: Draws the subject that answers pulses, when the first one comes; None where there is no brain to
            stimulate.
        seed: Where noise and variability come from.

    Attributes:
        settings: The same.
        silent: Pulses have no effect on it any more.
    """

    def __init__(self, settings: MuscleSettings, draw: Callable[[], Responder | None], seed: int) -> None:
        self.settings = settings
        self._draw = draw
        self.silent = False
        self._rng = np.random.default_rng((seed, STREAM))
        self._background = Background(settings.rate_hz, seed)
        self._stimuli: deque[Stimulus] = deque(maxlen=KEPT)
        self._activity = [(-np.inf, settings.preactivation_uv * 1e-6)]

    @cached_property
    def subject(self) -> Responder | None:
        """Who answers pulses."""
        return self._draw()

    def stimulate(self, number: int, time: float, image_from_coil: Transform, intensity: float) -> Stimulus:
        """A pulse at `time` of the cell's clock, s, from a coil that is truly there."""
        amplitude = 0.0
        if self.subject is not None and not self.silent:
            amplitude = self.subject.response(image_from_coil, intensity, self._rng)
        stimulus = Stimulus(number, time, intensity, amplitude)
        self._stimuli.append(stimulus)
        return stimulus

    def stimulus(self, number: int) -> Stimulus | None:
        """The newest pulse of that number."""
        return next((each for each in reversed(self._stimuli) if each.number == number), None)

    def preactivate(self, rms: float, time: float) -> None:
        """The muscle is tense from `time` on, with an electromyogram of `rms`, V."""
        self._activity = [*self._activity[-1:], (time, rms)]

    def samples(self, first: int, count: int) -> Floats:
        """What the amplifier measures, V: samples (count,) from number `first` on."""
        settings, background = self.settings, self._background
        times = np.arange(first, first + count) / settings.rate_hz
        signal = settings.noise_uv * 1e-6 * background.noise(first, count)
        signal += settings.hum_uv * 1e-6 * background.hum(first, count, settings.hum_hz)
        tension = self._tension(times)
        if tension.any():
            signal += tension * background.activity(first, count)
        for stimulus in self._stimuli:
            if times[0] - EFFECT < stimulus.time <= times[-1]:
                signal += self._evoked(stimulus, times - stimulus.time)
        full_scale = settings.full_scale_mv * 1e-3
        return np.clip(signal, -full_scale, full_scale)

    def _tension(self, times: Floats) -> Floats:
        since = np.searchsorted([time for time, _ in self._activity], times, side="right") - 1
        tension: Floats = np.array([rms for _, rms in self._activity])[since]
        return tension

    def _evoked(self, stimulus: Stimulus, since: Floats) -> Floats:
        settings = self.settings
        coupled = settings.artefact_mv * 1e-3 * stimulus.intensity / 100.0
        potential = stimulus.amplitude * evoked_potential(since - settings.latency, settings.scale)
        return potential + coupled * artefact(since, settings.artefact_decay)
