"""Streams of the simulated muscle, without a network: which samples are sent, and which pulses are given."""

from __future__ import annotations

import asyncio
from typing import Any

import numpy as np
import pytest

from pcmrs.spatial import Floats
from pcmrs.testing.clock import ManualClock, settle
from pcmrs_sim.lsl import streams
from pcmrs_sim.lsl.streams import CATCH_UP, LATENCY, PERIOD, EmgOutlet, PulseInlet

RATE = 1000
AHEAD = 5000.0
"""Time of Lab Streaming Layer minus that of the clock, s."""


class FakeLayer:
    """Lab Streaming Layer with one outlet, which remembers its chunks, and its own clock."""

    cf_float32 = 1

    def __init__(self, clock: ManualClock) -> None:
        self._clock = clock
        self.chunks: list[tuple[Floats, float]] = []
        self.info: tuple[Any, ...] = ()

    def local_clock(self) -> float:
        return self._clock.monotonic() + AHEAD

    def StreamInfo(self, *info: Any) -> FakeLayer:  # noqa: N802
        self.info = info
        return self

    def StreamOutlet(self, _info: FakeLayer) -> FakeLayer:  # noqa: N802
        return self

    def desc(self) -> FakeLayer:
        return self

    def append_child(self, _name: str) -> FakeLayer:
        return self

    def append_child_value(self, _name: str, _value: str) -> None:
        pass

    def push_chunk(self, signal: Floats, time: float) -> None:
        self.chunks.append((signal[:, 0], time))


class FakeInlet:
    """Markers that were pulled once."""

    def __init__(self) -> None:
        self.markers: list[tuple[str, float]] = []
        self.closed = False

    def pull(self) -> tuple[list[list[str]], list[float]]:
        markers, self.markers = self.markers, []
        return [[text] for text, _ in markers], [time for _, time in markers]

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def layer(clock: ManualClock, monkeypatch: pytest.MonkeyPatch) -> FakeLayer:
    layer = FakeLayer(clock)
    monkeypatch.setattr(streams, "load_lsl", lambda: layer)
    return layer


def numbers(first: int, count: int) -> Floats:
    """Samples that show their number, in uV."""
    return np.asarray(1e-6 * np.arange(first, first + count), dtype=float)


async def sent(clock: ManualClock, layer: FakeLayer, *stalls: float) -> Floats:
    """Numbers of the samples that are sent in a second, and in a second after each stall (s)."""
    running = asyncio.create_task(EmgOutlet("emg", RATE, numbers, clock).run())
    await settle()
    await clock.advance(1.0)
    for stall in stalls:
        clock.stall(stall)
        await clock.advance(1.0)
    running.cancel()
    await settle()
    return np.asarray(np.rint(np.concatenate([signal for signal, _ in layer.chunks])), dtype=float)


async def test_every_sample_is_sent_once_and_in_order(clock: ManualClock, layer: FakeLayer) -> None:
    samples = await sent(clock, layer, 0.5 * CATCH_UP)
    first = round((100.0 - LATENCY) * RATE)
    assert layer.info[:4] == ("emg", "EMG", 1, RATE)
    assert len(samples) == pytest.approx((2.0 + 0.5 * CATCH_UP) * RATE, abs=PERIOD * RATE + 1)
    assert np.array_equal(samples, first + np.arange(len(samples)))


async def test_after_a_long_stall_the_oldest_samples_are_left_out(clock: ManualClock, layer: FakeLayer) -> None:
    samples = await sent(clock, layer, CATCH_UP + 2.0)
    (gap,) = np.flatnonzero(np.diff(samples) != 1.0)
    assert np.diff(samples)[gap] == pytest.approx(2.0 * RATE, abs=2 * PERIOD * RATE)


async def test_a_chunk_has_the_time_of_its_newest_sample(clock: ManualClock, layer: FakeLayer) -> None:
    await sent(clock, layer)
    for signal, time in layer.chunks:
        assert time == pytest.approx(float(signal[-1]) / RATE + AHEAD, abs=1e-6)


@pytest.mark.usefixtures("layer")
async def test_pulses_have_the_time_of_the_clock_and_others_are_left(
    clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    inlet, given = FakeInlet(), list[tuple[int, float, float]]()
    monkeypatch.setattr(streams, "Inlet", lambda _name: inlet)
    running = asyncio.create_task(PulseInlet("pulses", lambda *pulse: given.append(pulse), clock).run())
    await settle()
    inlet.markers = [
        ('{"pulse": 3, "intensity": 55.0}', 100.25 + AHEAD),
        ("experiment started", 100.3 + AHEAD),
        ('{"pulse": 4}', 100.5 + AHEAD),
    ]
    await clock.advance(2 * PERIOD)
    assert [pulse[:2] for pulse in given] == [(3, 55.0), (4, 0.0)]
    assert [time for _, _, time in given] == pytest.approx([100.25, 100.5])
    running.cancel()
    await settle()
    assert inlet.closed
