"""The simulated muscle: its threshold is what it says, and its population is the published one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs_sim.tms.recruitment import RESPONSE, Recruitment, draw


def drawn(number: int) -> Recruitment:
    return draw(np.random.default_rng((5, number)))


@pytest.fixture(scope="module")
def subjects() -> list[Recruitment]:
    """A population. Nobody changes a subject, and drawing so many takes a second."""
    return [drawn(number) for number in range(300)]


@pytest.mark.parametrize("subject", [Recruitment(50.0), drawn(0), drawn(1)], ids=["middle", "first", "second"])
@pytest.mark.parametrize("above", [-8.0, -3.0, 0.0, 3.0, 8.0])
def test_the_probability_is_the_share_of_responses(subject: Recruitment, above: float) -> None:
    rng = np.random.default_rng(3)
    intensity = subject.threshold + above
    share = np.mean([subject.sample(intensity, rng) >= RESPONSE for _ in range(2000)])
    probability = subject.probability(intensity)
    assert share == pytest.approx(probability, abs=4.0 * np.sqrt(probability * (1.0 - probability) / 2000) + 0.005)


def test_half_of_the_pulses_at_the_threshold_are_answered(subjects: list[Recruitment]) -> None:
    for subject in subjects:
        assert subject.probability(subject.threshold) == pytest.approx(0.5, abs=1e-6)


@given(st.floats(0.0, 120.0), st.floats(0.0, 30.0))
def test_more_is_answered_more_often(intensity: float, more: float) -> None:
    subject = Recruitment(60.0)
    assert 0.0 <= subject.probability(intensity) <= subject.probability(intensity + more) <= 1.0


def test_the_threshold_is_all_that_moves_the_curve() -> None:
    low, high = Recruitment(40.0), Recruitment(70.0)
    assert low.probability(45.0) == pytest.approx(high.probability(75.0))
    assert low.sample(45.0, np.random.default_rng(1)) == pytest.approx(high.sample(75.0, np.random.default_rng(1)))


def test_without_stimulus_there_is_the_noise_of_the_measurement() -> None:
    rng = np.random.default_rng(2)
    silent = [Recruitment(60.0).sample(0.0, rng) for _ in range(500)]
    assert 6e-6 < np.median(silent) < 12e-6
    assert np.mean(np.array(silent) >= RESPONSE) < 0.01


def test_the_population_is_the_published_one(subjects: list[Recruitment]) -> None:
    # Prior in the code of Wang, Peterchev, Goetz 2023, fitted to 25,000 subjects of this model: 65.8 % ± 9.0 %.
    thresholds = np.array([subject.threshold for subject in subjects])
    assert thresholds.mean() == pytest.approx(65.8, abs=2.0)
    assert thresholds.std() == pytest.approx(9.0, abs=1.5)
    assert np.all((thresholds > 30.0) & (thresholds < 100.0))


def test_curves_are_about_as_flat_as_those_of_awiszus(subjects: list[Recruitment]) -> None:
    slopes = [
        subject.probability(subject.threshold + 0.5) - subject.probability(subject.threshold - 0.5)
        for subject in subjects
    ]
    spreads = [1.0 / (np.sqrt(2.0 * np.pi) * slope * s.threshold) for slope, s in zip(slopes, subjects, strict=True)]
    assert 0.07 < np.median(spreads) < 0.08


def test_amplitudes_grow_by_decades_and_vary_on_both_sides() -> None:
    subject = Recruitment(50.0)
    strong = replace(subject, input_spread=1e-9)
    rng = np.random.default_rng(4)
    full = np.log10([strong.sample(500.0, rng) for _ in range(500)])
    assert full.std() == pytest.approx(subject.output_spread, rel=0.15)
    steep = np.log10([subject.sample(50.0, rng) for _ in range(500)])
    assert steep.std() > 3.0 * full.std()


def test_a_seed_gives_a_subject() -> None:
    assert draw(np.random.default_rng(7)) == draw(np.random.default_rng(7)) != draw(np.random.default_rng(8))
