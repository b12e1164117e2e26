"""The electromyogram of one subject. Each sample is reproducible, in any order of requests."""

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

STORED_PULSES = 256
"""Number of newest pulses that are stored."""
PULSE_EFFECT_TIME = 0.25
"""Time after which a pulse has no effect on the electromyogram, s."""
STREAM = 2001
"""Number of the random stream of the responses, so that it is independent of the other streams of a seed."""


class Responder(Protocol):
    """A subject, as the muscle uses it; `pcmrs_sim.tms.subject.Subject` is one."""

    def response(self, image_from_coil: Transform, intensity: float, rng: np.random.Generator) -> float:
        """Return the peak-to-peak amplitude of the response to a pulse, V.

        Args:
            image_from_coil: True pose of the coil.
            intensity: Percent of the maximum stimulator output.
            rng: Source of the variability.
        """


@dataclass(frozen=True)
class Stimulus:
    """A pulse and its effect.

    Attributes:
        number: Number of the pulse.
        time: Time of the pulse on the cell's clock, s.
        intensity: Percent of the maximum stimulator output.
        amplitude: Peak-to-peak amplitude of the response, V.
    """

    number: int
    time: float
    intensity: float
    amplitude: float


class Muscle:
    """A relaxed muscle of the hand, its electrodes and their amplifier.

    Sample number n belongs to the time n / rate of the cell's clock. The model does not lower the threshold of an
    active muscle; that of a real one is lower.

    Args:
        settings: Settings of the electromyogram.
        draw: Returns the subject that responds to pulses; called at the first pulse. None for a phantom without a
            brain.
        seed: Seed of noise and variability.

    Attributes:
        settings: Settings of the electromyogram.
        silent: Pulses have no effect on the muscle.
    """

    def __init__(self, settings: MuscleSettings, draw: Callable[[], Responder | None], seed: int) -> None:
        self.settings = settings
        self._draw = draw
        self.silent = False
        self._rng = np.random.default_rng((seed, STREAM))
        self._background = Background(settings.rate_hz, seed)
        self._stimuli: deque[Stimulus] = deque(maxlen=STORED_PULSES)
        self._activity = [(-np.inf, settings.preactivation_uv * 1e-6)]

    @cached_property
    def subject(self) -> Responder | None:
        """The subject that responds to pulses; None for a phantom without a brain."""
        return self._draw()

    def stimulate(self, number: int, time: float, image_from_coil: Transform, intensity: float) -> Stimulus:
        """Give a pulse and return its effect.

        Args:
            number: Number of the pulse.
            time: Time of the pulse on the cell's clock, s.
            image_from_coil: True pose of the coil.
            intensity: Percent of the maximum stimulator output.
        """
        amplitude = 0.0
        if self.subject is not None and not self.silent:
            amplitude = self.subject.response(image_from_coil, intensity, self._rng)
        stimulus = Stimulus(number, time, intensity, amplitude)
        self._stimuli.append(stimulus)
        return stimulus

    def stimulus(self, number: int) -> Stimulus | None:
        """Return the newest pulse of a number; None if it was not given, or is no longer stored."""
        return next((each for each in reversed(self._stimuli) if each.number == number), None)

    def preactivate(self, rms: float, time: float) -> None:
        """Tense or relax the muscle.

        Args:
            rms: Standard deviation of the activity, V; 0 for a relaxed muscle.
            time: Time from which it is tense, on the cell's clock, s.
        """
        # The level before is kept, because samples from before `time` may still be requested.
        self._activity = [*self._activity[-1:], (time, rms)]

    def samples(self, first: int, count: int) -> Floats:
        """Return samples of the amplifier, V, (count,).

        Args:
            first: Number of the first sample.
            count: Number of samples.
        """
        settings, background = self.settings, self._background
        times = np.arange(first, first + count) / settings.rate_hz
        signal = settings.noise_uv * 1e-6 * background.noise(first, count)
        signal += settings.hum_uv * 1e-6 * background.hum(first, count, settings.hum_hz)
        tension = self._tension(times)
        if tension.any():
            signal += tension * background.activity(first, count)
        for stimulus in self._stimuli:
            if times[0] - PULSE_EFFECT_TIME < stimulus.time <= times[-1]:
                signal += self._evoked(stimulus, times - stimulus.time)
        full_scale = settings.full_scale_mv * 1e-3
        return np.clip(signal, -full_scale, full_scale)

    def _tension(self, times: Floats) -> Floats:
        """Return the standard deviation of the activity at times, V, (n,)."""
        latest = np.searchsorted([time for time, _ in self._activity], times, side="right") - 1
        tension: Floats = np.array([rms for _, rms in self._activity])[latest]
        return tension

    def _evoked(self, stimulus: Stimulus, since_pulse: Floats) -> Floats:
        """Return response and artefact of a pulse at times since it, s, (n,), V, (n,)."""
        settings = self.settings
        artefact_amplitude = settings.artefact_mv * 1e-3 * stimulus.intensity / 100.0
        potential = stimulus.amplitude * evoked_potential(since_pulse - settings.latency, settings.scale)
        return potential + artefact_amplitude * artefact(since_pulse, settings.artefact_decay)
