"""What can be proved of epochs and clocks without a stream: a recording, and an inlet on a pretended library."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.devices.lsl import inlet as inlet_module
from pcmrs.devices.lsl.epochs import SignalBuffer
from pcmrs.devices.lsl.inlet import FORGOTTEN, Inlet
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


class Library:
    """As much of the library as an inlet uses: one stream on a machine whose clock is `offset` behind ours."""

    class util:  # noqa: N801
        class TimeoutError(RuntimeError): ...

        class LostError(RuntimeError): ...

    def __init__(self, offset: float) -> None:
        self.offset: float | None = offset
        self.there = ["first"]
        self.lost = False
        self.pending: list[float] = []
        self.opened = 0
        self.now = 100.0

    def local_clock(self) -> float:
        return self.now

    def ContinuousResolver(self, **_: Any) -> Any:  # noqa: N802
        return SimpleNamespace(results=lambda: [self._info(uid) for uid in self.there])

    def StreamInlet(self, *_: Any, **__: Any) -> Any:  # noqa: N802
        self.opened += 1
        return SimpleNamespace(open_stream=self._wait, time_correction=self._correction, pull_chunk=self._pull)

    def _info(self, uid: str) -> Any:
        return SimpleNamespace(uid=lambda: uid, hostname=lambda: "amplifier")

    def _wait(self, timeout: float) -> None:
        raise self.util.TimeoutError

    def _correction(self, timeout: float) -> float:
        if self.offset is None:
            raise self.util.TimeoutError
        return self.offset

    def _pull(self, **_: Any) -> tuple[Floats, Floats]:
        if self.lost:
            raise self.util.LostError("the stream has been lost.")
        times, self.pending = np.array(self.pending), []
        return np.zeros((times.size, 1)), times


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> Library:
    library = Library(7.25)
    monkeypatch.setattr(inlet_module, "load_lsl", lambda: library)
    return library


def test_times_are_on_our_clock(library: Library) -> None:
    inlet = Inlet("emg")
    library.pending = [1.0, 2.0]
    assert inlet.pull()[1].tolist() == [8.25, 9.25]
    library.offset, library.pending = 7.5, [3.0]
    assert inlet.pull()[1].tolist() == [10.5]
    assert not inlet.problem


def test_nothing_is_pulled_before_the_clocks_were_compared(library: Library) -> None:
    inlet = Inlet("emg")
    library.offset, library.pending = None, [1.0]
    assert inlet.pull()[1].size == 0
    assert "being compared" in inlet.problem
    library.offset = 1.0
    assert inlet.pull()[1].tolist() == [2.0]


def test_a_lost_stream_is_not_opened_again_until_it_comes_back(library: Library) -> None:
    inlet = Inlet("emg")
    inlet.pull()
    library.lost = True
    assert inlet.pull()[1].size == 0
    assert "start its source again" in inlet.problem
    library.lost = False
    inlet.pull()
    assert library.opened == 1  # the resolver still remembers it
    library.there = ["first", "second"]
    library.pending = [1.0]
    assert inlet.pull()[1].tolist() == [8.25]
    library.there = []
    inlet.pull()
    assert "does not answer any more" in inlet.problem
    library.there = ["second"]
    inlet.pull()
    assert library.opened == 3


def test_a_stream_whose_link_broke_is_opened_again_later(library: Library) -> None:
    inlet = Inlet("emg")
    library.lost = True
    inlet.pull()
    library.lost = False
    library.now += FORGOTTEN + 0.1
    library.pending = [1.0]
    assert inlet.pull()[1].tolist() == [8.25]


def test_of_two_streams_neither_is_read(library: Library) -> None:
    inlet = Inlet("emg")
    library.there = ["first", "second"]
    inlet.pull()
    assert (library.opened, "exists 2 times" in inlet.problem) == (0, True)
    library.there = ["second"]
    inlet.pull()
    assert library.opened == 1
