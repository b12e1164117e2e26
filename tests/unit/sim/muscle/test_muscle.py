"""The simulated muscle: responses, saturation, tension and silence."""

import numpy as np
import pytest

from pcmrs.spatial import Floats, Transform
from pcmrs_sim.muscle.head_subject import draw_subject
from pcmrs_sim.muscle.muscle import Muscle
from pcmrs_sim.settings import MuscleSettings

RATE = 5000
CLEAN = MuscleSettings(noise_uv=0.0, hum_uv=0.0, artefact_mv=0.0)


class Fixed:
    """Answers every pulse alike."""

    def __init__(self, amplitude: float) -> None:
        self.amplitude = amplitude

    def response(self, image_from_coil: Transform, intensity: float, rng: np.random.Generator) -> float:
        return self.amplitude


def muscle(settings: MuscleSettings, amplitude: float = 1e-3, seed: int = 1) -> Muscle:
    return Muscle(settings, lambda: Fixed(amplitude), seed)


def around(muscle: Muscle, time: float, before: float = 0.1, after: float = 0.1) -> tuple[Floats, Floats]:
    first, last = round((time - before) * RATE), round((time + after) * RATE)
    return np.arange(first, last) / RATE - time, muscle.samples(first, last - first)


def test_noise_and_hum_are_as_large_as_configured() -> None:
    noisy = Muscle(MuscleSettings(noise_uv=4.0, hum_uv=0.0), lambda: None, 1).samples(0, 10 * RATE)
    assert noisy.std() == pytest.approx(4e-6, rel=0.02)
    humming = Muscle(MuscleSettings(noise_uv=0.0, hum_uv=7.0, hum_hz=60.0), lambda: None, 1).samples(0, 10 * RATE)
    assert np.abs(humming).max() == pytest.approx(7e-6, rel=1e-3)
    assert np.argmax(np.abs(np.fft.rfft(humming))) == 600


def test_a_pulse_is_answered_after_the_latency() -> None:
    relaxed = muscle(CLEAN)
    relaxed.stimulate(1, 100.0, Transform.identity(), 50.0)
    times, signal = around(relaxed, 100.0)
    assert np.ptp(signal) == pytest.approx(1e-3, rel=0.01)
    assert not signal[times < CLEAN.latency].any()
    assert np.abs(signal[(times > 0.02) & (times < 0.04)]).max() > 0.3e-3


def test_an_amplifier_saturates() -> None:
    settings = MuscleSettings(full_scale_mv=0.3)
    loud = muscle(settings)
    loud.stimulate(1, 100.0, Transform.identity(), 100.0)
    _, signal = around(loud, 100.0)
    assert (signal.min(), signal.max()) == (-0.3e-3, 0.3e-3)


def test_a_tense_muscle_shows_from_then_on() -> None:
    tense = muscle(CLEAN)
    tense.preactivate(50e-6, 100.0)
    times, signal = around(tense, 100.0, 1.0, 1.0)
    assert not signal[times < 0.0].any()
    assert signal[times >= 0.0].std() == pytest.approx(50e-6, rel=0.05)
    tense.preactivate(0.0, 100.5)
    times, signal = around(tense, 100.0, 0.0, 1.0)
    assert signal[times < 0.5].any()
    assert not signal[times >= 0.5].any()


def test_a_silent_muscle_answers_no_pulse() -> None:
    silent = muscle(CLEAN)
    silent.silent = True
    assert silent.stimulate(1, 100.0, Transform.identity(), 100.0).amplitude == 0.0
    assert not around(silent, 100.0)[1].any()


def test_the_seed_decides_everything() -> None:
    subject = draw_subject("head", 5)
    assert subject is not None
    signals = []
    for _ in range(2):
        drawn = Muscle(MuscleSettings(), lambda: draw_subject("head", 5), 5)
        for number in range(3):
            drawn.stimulate(number, 100.0 + number, subject.image_from_hotspot, 60.0)
        signals.append(drawn.samples(100 * RATE, 4 * RATE))
    assert np.array_equal(signals[0], signals[1])
