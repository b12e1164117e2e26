"""Epochs of a recording whose samples are their times."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.lsl.epochs import SignalBuffer
from pcmrs.errors import DeviceError
from pcmrs.spatial import Floats

RATE = 1000.0


def recorded(times: Floats, packet: int, jitter: float = 0.002, seconds: float = 10.0) -> SignalBuffer:
    """A recording whose samples are their true times, fed in packets."""
    recording = SignalBuffer(RATE, seconds, jitter)
    for start in range(0, times.size, packet):
        recording.add(times[start : start + packet], times[start : start + packet])
    return recording


@given(st.integers(1, 200), st.floats(100.0, 101.0), st.floats(0.05, 0.5), st.floats(0.05, 0.5), st.floats(0.0, 1.0))
def test_an_epoch_holds_just_the_samples_of_its_time(
    packet: int, begin: float, before: float, after: float, where: float
) -> None:
    times = begin + np.arange(2000) / RATE
    pulse = begin + 0.6 + 0.7 * where
    first, samples = recorded(times, packet).cut(pulse - before, pulse + after)
    assert first == pytest.approx(samples[0], abs=1e-6)
    assert np.array_equal(samples, times[(times >= pulse - before) & (times <= pulse + after)])


@given(st.floats(0.0, 0.0018), st.integers(2, 50))
def test_packets_with_uneven_stamps_are_averaged_out(shift: float, packet: int) -> None:
    times = 100.0 + np.arange(2000) / RATE
    stamped = times + shift * (-1.0) ** (np.arange(2000) // packet)
    recording = SignalBuffer(RATE, 10.0, 0.004)
    recording.add(stamped, times)
    first, samples = recording.cut(100.5, 101.0)
    assert abs(first - samples[0]) <= shift * packet / samples.size + 1e-6
    assert np.diff(samples) == pytest.approx(1 / RATE)


@given(st.integers(510, 980), st.integers(5, 400))
def test_missing_samples_are_refused(at: int, lost: int) -> None:
    times = 100.0 + np.arange(2000) / RATE
    kept = np.delete(times, np.arange(at, min(at + lost, 990)))
    if kept.size > times.size - 5:
        return
    with pytest.raises(DeviceError, match="missing"):
        recorded(kept, 50).cut(100.5, 101.0)


def test_epoch_older_than_the_buffer_is_missing() -> None:
    recording = recorded(100.0 + np.arange(2000) / RATE, 100, seconds=1.0)
    with pytest.raises(DeviceError, match="missing"):
        recording.cut(100.5, 100.7)
    assert recording.cut(101.5, 101.7)[1].size == pytest.approx(200, abs=1)
