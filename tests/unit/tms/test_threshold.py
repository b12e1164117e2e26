"""Threshold hunts: what they ask, what they come to, and when they refuse."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import RefusalError
from pcmrs.tms.settings import ThresholdMethod, ThresholdSettings
from pcmrs.tms.threshold import MotorThresholdEstimator
from pcmrs_sim.tms.recruitment import Recruitment
from tests.support.trials import examples
from tests.unit.tms.hunts import METHODS, hunted, muscle, step_at


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
