"""Shapes of responses and artefacts, and the background of an electromyogram."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs_sim.muscle.waveform import BAND, Background, artefact, evoked_potential
from tests.support.trials import examples

RATE = 5000


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
