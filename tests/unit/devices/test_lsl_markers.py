"""Markers of pulses are JSON among other markers."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.lsl.markers import PulseMarker, read_pulse

pulses = st.builds(
    PulseMarker,
    st.integers(-(2**53), 2**53),
    st.none() | st.floats(allow_nan=False, allow_infinity=False),
)


@given(pulses)
def test_a_pulse_is_read_as_it_was_marked(marker: PulseMarker) -> None:
    assert read_pulse(marker.text) == read_pulse(marker.text.encode()) == marker


@given(st.binary(max_size=60) | st.text(max_size=60))
def test_any_other_marker_is_none(text: str | bytes) -> None:
    marker = read_pulse(text)
    assert marker is None or isinstance(marker, PulseMarker)
