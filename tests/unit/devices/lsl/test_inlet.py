"""An inlet on a pretended library: clocks, and streams that end and come back."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pcmrs.devices.lsl import inlet as inlet_module
from pcmrs.devices.lsl.inlet import FORGOTTEN, Inlet
from pcmrs.spatial import Floats


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
