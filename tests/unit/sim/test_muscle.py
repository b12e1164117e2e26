import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.motion.force import ForceSettings
from pcmrs.kinematics.arms import ARMS
from pcmrs.spatial import Floats, Transform
from pcmrs_sim.head import CENTRE, level, outward_normal, surface_point
from pcmrs_sim.muscle.head_subject import closest_on_scalp, draw_subject
from pcmrs_sim.muscle.muscle import Muscle
from pcmrs_sim.muscle.waveform import BAND, Background, artefact, evoked_potential
from pcmrs_sim.settings import MuscleSettings, SimSettings
from pcmrs_sim.world import World
from tests.support.trials import examples

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


@given(st.floats(0.001, 0.005))
def test_a_response_has_unit_size_and_lasts_six_scales(scale: float) -> None:
    times = np.arange(-0.01, 0.05, 1e-5)
    shape = evoked_potential(times, scale)
    assert np.ptp(shape) == pytest.approx(1.0, rel=1e-3)
    assert not shape[(times < 0.0) | (times > 6.0 * scale)].any()
    signs = np.sign(shape[np.abs(shape) > 0.05])
    assert np.count_nonzero(np.diff(signs)) >= 1  # at least two phases


def test_an_artefact_begins_with_the_pulse_and_decays() -> None:
    times = np.array([-1e-4, 0.0, 1e-3, 2e-3])
    assert artefact(times, 1e-3) == pytest.approx([0.0, 1.0, np.exp(-1.0), np.exp(-2.0)])


@given(st.integers(0, 10**9), st.integers(1, 12000), st.integers(0, 11999))
@examples(30)
def test_any_stretch_of_the_background_is_part_of_any_other(first: int, count: int, offset: int) -> None:
    whole, again = Background(RATE, 7), Background(RATE, 7)
    offset %= count
    for signal in ("noise", "activity"):
        long = getattr(whole, signal)(first, count)
        assert np.array_equal(long[offset:], getattr(again, signal)(first + offset, count - offset))
    assert whole.hum(first, count, 50.0)[offset:] == pytest.approx(again.hum(first + offset, count - offset, 50.0))


def test_activity_lies_in_the_band_of_a_muscle() -> None:
    activity = Background(RATE, 1).activity(100 * RATE, 20 * RATE)
    power = np.abs(np.fft.rfft(activity)) ** 2
    hertz = np.fft.rfftfreq(activity.size, 1 / RATE)
    within = (hertz >= BAND[0] - 1) & (hertz <= BAND[1] + 1)
    assert power[within].sum() / power.sum() > 0.99
    assert activity.std() == pytest.approx(1.0, rel=1e-6)


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


@given(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.3, 1)), st.floats(-0.005, 0.01))
@examples(25)
def test_the_nearest_point_of_the_scalp_is_the_nearest(direction: tuple[float, float, float], height: float) -> None:
    foot = surface_point(direction)
    point = foot + height * outward_normal(foot) + np.array((0.001, -0.002, 0.0005))
    found, normal = (rows[0] for rows in closest_on_scalp(point[None]))
    tangents = np.linalg.svd(normal[None])[2][1:]
    steps = 1e-4 * np.stack([np.cos(np.arange(8)), np.sin(np.arange(8))], axis=1) @ tangents
    beside = np.array([surface_point(found + step - CENTRE) for step in steps])
    assert level(found) == pytest.approx(0.0, abs=1e-9)
    assert np.linalg.norm(found - point) <= np.linalg.norm(beside - point, axis=1).min() + 1e-9
    assert normal == pytest.approx(outward_normal(found))


def make_world(phantom: str) -> World:
    settings = SimSettings(phantom=phantom)  # type: ignore[arg-type]
    return World(settings, ARMS["iiwa14"], ForceSettings(), 0.0)


def test_only_a_head_answers_and_only_where_it_is_stimulated() -> None:
    world = make_world("head")
    told: list[tuple[int, float, float]] = []
    world.pulse_listeners.append(lambda *pulse: told.append(pulse))
    world.stimulate(1, 100.0, 50.0)
    far = world.muscle.stimulus(1)
    assert far is not None
    assert far.amplitude < 50e-6  # the arm is at home
    assert told == [(1, 100.0, 50.0)]
    subject = draw_subject("head", world.settings.seed)
    assert subject is not None
    assert world.muscle.stimulate(2, 60.0, subject.image_from_hotspot, 100.0).amplitude > 50e-6
    bone = make_world("femur")
    bone.stimulate(1, 100.0, 50.0)
    none = bone.muscle.stimulus(1)
    assert none is not None
    assert none.amplitude == 0.0


def test_another_seed_is_another_subject() -> None:
    world = make_world("head")
    before = world.muscle.subject
    world.reseed(2)
    assert world.muscle.subject != before
