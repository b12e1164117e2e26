"""Single pulses keep their interval and their number."""

from __future__ import annotations

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import RefusalError
from pcmrs.tms.intervals import IntervalSettings, check_count, check_interval


def test_pulses_keep_their_distance_and_number() -> None:
    limits = IntervalSettings(least=5.0, most_pulses=3)
    check_interval(100.0, None, 0, limits)
    check_interval(105.0, 100.0, 1, limits)
    for now in (104.0, 99.0, math.nan):
        with pytest.raises(RefusalError) as refused:
            check_interval(now, 100.0, 1, limits)
        assert refused.value.refusal_code == "pulse_too_soon"
    check_count(2, limits)
    with pytest.raises(RefusalError) as refused:
        check_count(3, limits)
    assert refused.value.refusal_code == "too_many_pulses"


def test_before_the_first_pulse_the_text_names_arming() -> None:
    limits = IntervalSettings(least=5.0)
    with pytest.raises(RefusalError, match=r"No pulse was given yet, so the interval counts from arming, 3\.38 s ago"):
        check_interval(103.38, 100.0, 0, limits)
    with pytest.raises(RefusalError, match=r"The last pulse, or arming after one with an unknown .* was 3\.38 s ago"):
        check_interval(103.38, 100.0, 2, limits)


@given(st.floats(1.1, 60.0), st.floats(0.0, 1.0))
def test_a_pulse_is_accepted_after_the_wait_that_was_named(least: float, share: float) -> None:
    limits, last = IntervalSettings(least=least), 100.0
    now = last + share * least
    try:
        check_interval(now, last, 1, limits)
    except RefusalError as refused:
        check_interval(now + refused.fields["wait"] + 1e-9, last, 1, limits)
    else:
        assert now - last >= least


@pytest.mark.parametrize("values", [{"least": 1.0}, {"least": 61.0}, {"most_pulses": 0}, {"most_pulses": 1801}])
def test_repetitive_stimulation_cannot_be_configured(values: dict[str, float]) -> None:
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert(values, IntervalSettings)
