"""Motor evoked potentials: measured as made, and not believed where they cannot be."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import RefusalError
from pcmrs.messages import Epoch
from pcmrs.spatial import Floats
from pcmrs.tms.mep import Mep, judge_mep, waveform
from pcmrs.tms.settings import MepSettings
from tests.support.trials import examples

RATE_HZ = 5000.0
START, END = -0.12, 0.1
TIMES = START + np.arange(round((END - START) * RATE_HZ)) / RATE_HZ
ONSET, CYCLE = 0.022, 0.010
SETTINGS = MepSettings()


def response(peak_to_peak: float, onset: float = ONSET) -> Floats:
    """One cycle of a sine from the onset on: half of the amplitude up, half down, a quarter and three quarters in."""
    since = TIMES - onset
    return np.where((since >= 0.0) & (since < CYCLE), 0.5 * peak_to_peak * np.sin(2.0 * np.pi * since / CYCLE), 0.0)


def noise(rms: float, seed: int = 1) -> Floats:
    return np.random.default_rng(seed).normal(0.0, rms, len(TIMES))


def epoch(samples: Floats, **changed: Any) -> Epoch:
    made = Epoch(pulse=3, muscle="FDI", rate_hz=RATE_HZ, start=START, samples=samples.tolist(), full_scale=0.010)
    return msgspec.structs.replace(made, **changed)


def judged(samples: Floats, **changed: Any) -> Mep:
    return judge_mep(epoch(samples, **changed), SETTINGS)


def refused(made: Epoch) -> str:
    with pytest.raises(RefusalError) as refusal:
        judge_mep(made, SETTINGS)
    return refusal.value.refusal_code


def judged_or_refused(made: Epoch) -> Mep | str:
    try:
        return judge_mep(made, SETTINGS)
    except RefusalError as refusal:
        return refusal.refusal_code


@pytest.mark.parametrize("microvolts", [60.0, 200.0, 3000.0])
def test_amplitude_peaks_and_onset_are_those_that_were_made(microvolts: float) -> None:
    mep = judged(response(microvolts * 1e-6) + noise(1e-7))
    assert mep.present
    assert mep.valid
    assert mep.peak_to_peak == pytest.approx(microvolts * 1e-6, rel=0.01)
    assert mep.peak == pytest.approx(ONSET + CYCLE / 4.0, abs=3.0 / RATE_HZ)
    assert mep.trough == pytest.approx(ONSET + 0.75 * CYCLE, abs=3.0 / RATE_HZ)
    assert mep.latency == pytest.approx(ONSET, abs=0.001)
    assert mep.baseline_rms == pytest.approx(1e-7, rel=0.2)


@pytest.mark.parametrize(("microvolts", "present"), [(49.0, False), (51.0, True)])
def test_a_response_begins_at_fifty_microvolts(microvolts: float, present: bool) -> None:
    mep = judged(response(microvolts * 1e-6) + noise(1e-9))
    assert mep.present is present
    assert (mep.latency is None) is not present
    assert mep.valid


def test_too_early_or_too_late_onset_is_no_response() -> None:
    assert not judged(response(1e-3, onset=0.055) + noise(1e-7)).present
    early = judged(response(1e-3, onset=0.003) + noise(1e-7))
    assert not early.present


@given(
    microvolts=st.floats(10.0, 2000.0),
    offset_mv=st.floats(-5.0, 5.0),
    hum_uv=st.floats(0.0, 200.0),
    phase=st.floats(0.0, 6.28),
    mains_hz=st.sampled_from([50.0, 60.0]),
)
@examples(40)
def test_offset_and_hum_change_nothing(
    microvolts: float, offset_mv: float, hum_uv: float, phase: float, mains_hz: float
) -> None:
    clean = response(microvolts * 1e-6) + noise(2e-6)
    hum = offset_mv * 1e-3 + hum_uv * 1e-6 * np.sin(2.0 * np.pi * mains_hz * TIMES + phase)
    told = msgspec.structs.replace(SETTINGS, mains_hz=mains_hz)
    alone, together = judge_mep(epoch(clean), told), judge_mep(epoch(clean + hum), told)
    assert together.peak_to_peak == pytest.approx(alone.peak_to_peak, abs=1e-9)
    assert together.baseline_rms == pytest.approx(alone.baseline_rms, abs=1e-9)
    assert (together.peak, together.trough) == (alone.peak, alone.trough)


@given(factor=st.floats(0.2, 3.0))
@examples(20)
def test_amplitudes_scale_with_the_signal(factor: float) -> None:
    samples = response(500e-6) + noise(2e-6)
    once, scaled = judged(samples), judged(factor * samples)
    assert scaled.peak_to_peak == pytest.approx(factor * once.peak_to_peak)
    assert scaled.baseline_rms == pytest.approx(factor * once.baseline_rms)
    assert (scaled.latency, scaled.peak) == (once.latency, once.peak)


@given(late=st.integers(0, 60))
@examples(20)
def test_the_latency_follows_the_response(late: int) -> None:
    quiet = noise(1e-8)
    first, moved = judged(response(500e-6) + quiet), judged(response(500e-6, ONSET + late / RATE_HZ) + quiet)
    assert first.latency is not None
    assert moved.latency == pytest.approx(first.latency + late / RATE_HZ, abs=1.5 / RATE_HZ)
    assert moved.peak_to_peak == pytest.approx(first.peak_to_peak, rel=0.01)


def test_the_sign_of_the_electrodes_does_not_matter() -> None:
    samples = response(500e-6) + noise(2e-6)
    once, turned = judged(samples), judged(-samples)
    assert turned.peak_to_peak == pytest.approx(once.peak_to_peak)
    assert (turned.peak, turned.trough) == (once.trough, once.peak)


@pytest.mark.parametrize("mains_hz", [0.0, 50.0])
def test_hum_left_alone_counts_as_activity(mains_hz: float) -> None:
    hum = 40e-6 * np.sin(2.0 * np.pi * 50.0 * TIMES) + noise(1e-6)
    mep = judge_mep(epoch(hum), msgspec.structs.replace(SETTINGS, mains_hz=mains_hz))
    assert mep.preactivated is (mains_hz == 0.0)
    assert not mep.present


def test_tense_muscle_gives_no_valid_response() -> None:
    mep = judged(response(500e-6) + noise(12e-6))
    assert (mep.preactivated, mep.valid, mep.present) == (True, False, False)
    assert judged(response(500e-6) + noise(8e-6)).present


@pytest.mark.parametrize(("decay", "artefact"), [(0.0008, False), (0.004, True)])
def test_an_artefact_that_reaches_the_window_is_marked(decay: float, artefact: bool) -> None:
    stimulus = np.where(TIMES >= 0.0, 5e-3 * np.exp(-np.maximum(TIMES, 0.0) / decay), 0.0)
    mep = judged(response(200e-6) + stimulus + noise(1e-6))
    assert (mep.artefact, mep.valid, mep.present) == (artefact, not artefact, not artefact)


@pytest.mark.parametrize("full_scale", [0.001, None])
def test_a_response_at_the_rail_is_marked(full_scale: float | None) -> None:
    samples = np.clip(response(4e-3) + noise(1e-6), -0.001, 0.001)
    mep = judged(samples, full_scale=full_scale)
    assert (mep.saturated, mep.present) == (True, False)
    assert not judged(response(1.5e-3) + noise(1e-6), full_scale=full_scale).saturated


def test_a_stimulus_at_the_rail_is_no_matter() -> None:
    stimulus = np.where((TIMES >= 0.0) & (TIMES < 0.004), 0.01, 0.0)
    assert judged(response(200e-6) + stimulus + noise(1e-6)).present


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"samples": []}, "bad_epoch"),
        ({"samples": [0.0, math.nan]}, "bad_epoch"),
        ({"samples": [0.0, math.inf]}, "bad_epoch"),
        ({"samples": [0.0, 50.0] * 500}, "bad_epoch"),  # microvolts
        ({"rate_hz": 0.0}, "bad_epoch"),
        ({"rate_hz": -5000.0}, "bad_epoch"),
        ({"rate_hz": 250.0}, "bad_epoch"),
        ({"rate_hz": math.nan}, "bad_epoch"),
        ({"rate_hz": math.inf}, "bad_epoch"),
        ({"start": math.nan}, "bad_epoch"),
        ({"start": -0.05}, "epoch_too_short"),  # no baseline
        ({"start": -0.3}, "epoch_too_short"),  # no window
        ({"rate_hz": 20000.0}, "epoch_too_short"),
        ({"samples": [1e-3]}, "emg_dead"),
        ({"samples": [1e-3] * len(TIMES)}, "emg_dead"),
    ],
)
def test_epochs_that_cannot_be_judged_are_refused(changed: dict[str, Any], code: str) -> None:
    assert refused(msgspec.structs.replace(epoch(noise(1e-6)), **changed)) == code


def test_the_epoch_may_just_fit() -> None:
    fits = (TIMES >= -0.105 - 1e-9) & (TIMES <= 0.05 + 1e-9)
    samples = (response(200e-6) + noise(1e-6))[fits]
    assert judged(samples, start=float(TIMES[fits][0])).present
    assert refused(epoch(samples[:-2], start=float(TIMES[fits][0]))) == "epoch_too_short"
    assert refused(epoch(samples[2:], start=float(TIMES[fits][2]))) == "epoch_too_short"


def test_the_waveform_is_the_signal_without_its_offset() -> None:
    times, samples = waveform(epoch(response(200e-6) + 1e-3 + noise(1e-9)), SETTINGS)
    assert times == pytest.approx(TIMES)
    assert samples == pytest.approx(response(200e-6), abs=1e-8)


@given(
    samples=st.lists(st.floats(width=32) | st.floats(-1e-2, 1e-2), max_size=12),
    repeats=st.integers(1, 150),
    rate_hz=st.floats() | st.floats(900.0, 20000.0),
    start=st.floats() | st.floats(-0.2, 0.0),
    full_scale=st.none() | st.floats(1e-4, 1.0),
)
@examples(300)
def test_whatever_comes_is_judged_or_refused(
    samples: list[float], repeats: int, rate_hz: float, start: float, full_scale: float | None
) -> None:
    made = Epoch(pulse=1, muscle="FDI", rate_hz=rate_hz, start=start, samples=samples * repeats, full_scale=full_scale)
    mep = judged_or_refused(made)
    if isinstance(mep, str):
        assert mep in ("bad_epoch", "epoch_too_short", "emg_dead")
        return
    assert 0.0 <= mep.peak_to_peak < 10.0
    assert SETTINGS.window_start - 1e-3 <= min(mep.peak, mep.trough)
    assert max(mep.peak, mep.trough) <= SETTINGS.window_end + 1e-3
    assert mep.present is (mep.valid and mep.peak_to_peak >= 50e-6)


@pytest.mark.parametrize(
    "values",
    [
        {"window_start": 0.05, "window_end": 0.05},
        {"baseline_start": 0.0},
        {"baseline_end": 0.01},
        {"artefact_time": 0.02},
        {"threshold_uv": 0.0},
        {"colour": 1},
    ],
)
def test_settings_that_make_no_sense_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(values, MepSettings)
