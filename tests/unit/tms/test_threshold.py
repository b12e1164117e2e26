"""Threshold hunts: what they ask, what they come to, and when they refuse."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

from pcmrs.errors import RefusalError
from pcmrs.tms.intervals import IntervalSettings, check_count, check_interval
from pcmrs.tms.settings import ThresholdMethod, ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs_sim.tms.recruitment import Recruitment
from tests.support.trials import examples

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


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("threshold", [30.0, 47.0, 66.0, 85.0])
def test_it_finds_a_threshold(method: ThresholdMethod, threshold: float) -> None:
    errors = []
    for seed in range(20):
        hunt = hunted(ThresholdSettings(method=method), muscle(threshold, seed))
        assert hunt.finished
        errors.append(abs(hunt.estimate.threshold - threshold))
    spread = Recruitment(threshold).input_spread
    # 16 pulses of that spread: sqrt(pi / 2 / 16) of it for a sample of yes and no at the threshold.
    assert np.sqrt(np.mean(np.square(errors))) < 0.6 * spread


@pytest.mark.parametrize("method", METHODS)
@given(threshold=st.floats(20.0, 95.0))
@examples(20)
def test_a_muscle_without_variability_is_found_within_a_step(method: ThresholdMethod, threshold: float) -> None:
    hunt = hunted(ThresholdSettings(method=method), step_at(threshold))
    assert hunt.finished
    assert hunt.estimate.threshold == pytest.approx(threshold, abs=1.0 + 0.02 * threshold)


def brute_force(hunt: MotorThresholdEstimator) -> tuple[float, float, float]:
    """Yes and no only: prior times cumulative Gaussians, value by value."""
    prior = norm(hunt.settings.prior_mean, hunt.settings.prior_sd)
    grid = np.arange(4, 600) / 4.0
    density = np.empty(len(grid))
    for index, threshold in enumerate(grid):
        density[index] = prior.pdf(threshold)
        for pulse in hunt.pulses:
            probability = norm.cdf(pulse.intensity, threshold, 0.07 * threshold)
            density[index] *= probability if pulse.responded else 1.0 - probability
    shares = np.cumsum(density) / density.sum()
    return grid[np.argmax(density)], grid[np.argmax(shares >= 0.025)], grid[np.argmax(shares >= 0.975)]


@given(st.lists(st.tuples(st.integers(45, 75), st.booleans()), min_size=1, max_size=8))
@examples(15)
def test_the_estimate_is_the_maximum_of_the_likelihood(pulses: list[tuple[int, bool]]) -> None:
    hunt = MotorThresholdEstimator.begin(ThresholdSettings(interval=0.001, floor=1.0))
    for intensity, responded in pulses:
        if hunt.refusal is None:
            hunt = hunt.after(float(intensity), responded)
    best, low, high = brute_force(hunt)
    found = hunt.estimate
    assert found.threshold == pytest.approx(best, abs=0.26)
    assert found.low == pytest.approx(low, abs=0.26)
    assert found.high == pytest.approx(high, abs=0.26)


def test_amplitudes_tell_more_than_yes_and_no() -> None:
    seeds = range(40)
    with_amplitude = [len(hunted(ThresholdSettings(), muscle(60.0, seed)).pulses) for seed in seeds]
    without = [len(hunted(ThresholdSettings(), yes_or_no(muscle(60.0, seed))).pulses) for seed in seeds]
    assert np.median(with_amplitude) <= 17 < np.median(without)


def test_the_larger_the_response_the_lower_the_threshold() -> None:
    base = MotorThresholdEstimator.begin(ThresholdSettings())
    small, large = (base.after(60.0, True, amplitude).estimate.threshold for amplitude in (51e-6, 1e-3))
    none, almost = (base.after(60.0, False, amplitude).estimate.threshold for amplitude in (5e-6, 49e-6))
    assert large < small < none
    assert large < almost < none
    assert base.after(60.0, False, 1e-6).estimate == base.after(60.0, False, 20e-6).estimate  # both are noise


def test_it_follows_five_of_ten() -> None:
    answers = {35: False, 40: False, 45: True, 44: True}
    hunt = hunted(
        ThresholdSettings(method="relative_frequency"), lambda intensity: (answers.get(int(intensity), False), None)
    )
    # Up until three of three, then five at once for each step that is answered, six misses for the last.
    asked = [pulse.intensity for pulse in hunt.pulses]
    assert asked == [35.0, 40.0, *[45.0] * 8, *[44.0] * 5, *[43.0] * 6]
    assert hunt.estimate.threshold == 44.0
    assert (hunt.estimate.low, hunt.estimate.high) == (None, None)


@pytest.mark.parametrize(
    ("answered", "threshold"), [("ynynynynnn", 51.0), ("ynynynynny", 50.0), ("nnnnnn", 51.0), ("yyyyy", 50.0)]
)
def test_a_step_counts_as_answered_from_five_of_ten_on(answered: str, threshold: float) -> None:
    script = {51: iter("yyyyyyyyyy"), 50: iter(answered), 49: iter("n" * 10)}
    hunt = hunted(
        ThresholdSettings(method="relative_frequency", start=51.0),
        lambda intensity: (next(script[int(intensity)]) == "y", None),
    )
    assert hunt.estimate.threshold == threshold


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("ceiling", [40.0, 62.5, 100.0])
def test_a_muscle_that_never_answers_is_refused_at_the_ceiling(method: ThresholdMethod, ceiling: float) -> None:
    hunt = hunted(ThresholdSettings(method=method, ceiling=ceiling), step_at(1e9))
    assert (hunt.refusal, hunt.finished) == ("above_ceiling", False)
    assert max(pulse.intensity for pulse in hunt.pulses) == math.floor(ceiling)
    assert len(hunt.pulses) < 40
    with pytest.raises(RefusalError, match="ceiling") as refused:
        hunt.next_intensity()
    assert refused.value.refusal_code == "above_ceiling"


@pytest.mark.parametrize("method", METHODS)
def test_a_signal_that_always_answers_is_refused_at_the_floor(method: ThresholdMethod) -> None:
    hunt = hunted(ThresholdSettings(method=method, max_pulses=500), step_at(0.0))
    assert hunt.refusal == "below_floor"
    assert hunt.estimate.threshold <= 10.0


@pytest.mark.parametrize("method", METHODS)
def test_it_gives_up_after_so_many_pulses(method: ThresholdMethod) -> None:
    hunt = hunted(ThresholdSettings(method=method, max_pulses=7, interval=0.01), muscle(70.0, 1))
    assert (len(hunt.pulses), hunt.refusal) == (7, "not_converged")
    with pytest.raises(RefusalError) as refused:
        hunt.after(60.0, True)
    assert refused.value.refusal_code == "not_converged"


@pytest.mark.parametrize("method", METHODS)
def test_a_finished_hunt_takes_no_more(method: ThresholdMethod) -> None:
    hunt = hunted(ThresholdSettings(method=method), muscle(50.0, 3))
    with pytest.raises(RefusalError) as refused:
        hunt.next_intensity()
    assert refused.value.refusal_code == "hunt_finished"


@pytest.mark.parametrize("intensity", [0.0, -5.0, 80.5, math.nan, math.inf])
def test_pulses_that_cannot_be_are_refused(intensity: float) -> None:
    hunt = MotorThresholdEstimator.begin(ThresholdSettings(ceiling=80.0))
    with pytest.raises(RefusalError) as refused:
        hunt.after(intensity, responded=True)
    assert refused.value.refusal_code == "bad_intensity"


def test_relative_frequency_counts_only_what_it_asked_for() -> None:
    hunt = MotorThresholdEstimator.begin(ThresholdSettings(method="relative_frequency"))
    with pytest.raises(RefusalError, match="requested 35 %"):
        hunt.after(36.0, responded=True)


@pytest.mark.parametrize(
    ("responded", "amplitude"), [(True, 49e-6), (False, 50e-6), (True, math.nan), (True, math.inf), (False, -1e-6)]
)
def test_amplitudes_that_contradict_are_refused(responded: bool, amplitude: float) -> None:
    with pytest.raises(RefusalError) as refused:
        MotorThresholdEstimator.begin(ThresholdSettings()).after(60.0, responded, amplitude)
    assert refused.value.refusal_code == "bad_amplitude"


@pytest.mark.parametrize("method", METHODS)
def test_journalled_hunt_continues_unchanged(method: ThresholdMethod) -> None:
    answer = muscle(55.0, 9)
    hunt = MotorThresholdEstimator.begin(ThresholdSettings(method=method))
    for _ in range(6):
        hunt = hunt.after(hunt.next_intensity(), *answer(hunt.next_intensity()))
    again = msgspec.json.decode(msgspec.json.encode(hunt), type=MotorThresholdEstimator)
    assert again == hunt
    assert (again.estimate, again.next_intensity()) == (hunt.estimate, hunt.next_intensity())


@pytest.mark.parametrize(
    "values",
    [{"ceiling": 8.0}, {"ceiling": 101.0}, {"interval": 0.0}, {"method": "guess"}, {"noise_uv": 60.0}, {"colour": 1}],
)
def test_settings_that_make_no_sense_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(values, ThresholdSettings)


def test_pulses_keep_their_distance_and_number() -> None:
    limits = IntervalSettings(least=5.0, most_pulses=3)
    check_interval(100.0, None, limits)
    check_interval(105.0, 100.0, limits)
    for now in (104.0, 99.0, math.nan):
        with pytest.raises(RefusalError) as refused:
            check_interval(now, 100.0, limits)
        assert refused.value.refusal_code == "pulse_too_soon"
    check_count(2, limits)
    with pytest.raises(RefusalError) as refused:
        check_count(3, limits)
    assert refused.value.refusal_code == "too_many_pulses"
