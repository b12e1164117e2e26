""""""

from __future__ import annotations

import msgspec
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


def test_only_pulses_are_read_as_pulses() -> None:
    assert read_pulse('{"pulse": 3, "intensity": 55.0}') == PulseMarker(3, 55.0)
    assert read_pulse('{"pulse": 3}') == PulseMarker(3, None)
    for text in ("3", "robot:0->1", '{"pulse": "x"}', '{"pulse": 1.5}', "[]", "", '{"pulse": 3'):
        assert read_pulse(text) is None


@given(st.binary(max_size=60) | st.text(max_size=40))
def test_any_marker_is_a_pulse_or_none(marker: bytes | str) -> None:
    read = read_pulse(marker)
    assert read is None or isinstance(read.pulse, int)


@given(st.integers(0, 10**9), st.none() | st.floats(0.0, 100.0))
def test_a_marker_reads_back(number: int, intensity: float | None) -> None:
    assert read_pulse(PulseMarker(number, intensity).text.encode()) == PulseMarker(number, intensity)


def test_a_marker_is_plain_json() -> None:
    assert msgspec.json.decode(PulseMarker(3, 55.0).text) == {"pulse": 3, "intensity": 55.0}
