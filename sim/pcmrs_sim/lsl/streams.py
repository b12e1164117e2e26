"""The muscle on Lab Streaming Layer: its electromyogram as a stream, and pulses heard as markers, both ways."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pcmrs.clock import Clock
from pcmrs.devices.lsl.inlet import Inlet
from pcmrs.devices.lsl.library import load_lsl
from pcmrs.devices.lsl.markers import read_pulse
from pcmrs.spatial import Floats

PERIOD = 0.01
"""Seconds between packets, and between looks for markers."""
LATENCY = 0.1
"""Age of the newest sample that is sent, s: an amplifier's buffers, and time in which a pulse's marker arrives."""
CATCH_UP = 1.0
"""Samples that are older than this are left out after a stall, s."""
MICROVOLTS = 1e6


def lsl_minus(clock: Clock) -> float:
    """Time of Lab Streaming Layer minus time of `clock`, s: constant where both run at the machine's rate."""
    return float(load_lsl().local_clock() - clock.monotonic())


class EmgOutlet:
    """A stream of electromyogram that follows the clock.

    Args:
        name: Of the stream.
        rate: Whole samples per second.
        samples: Tells samples by the number of the first and their count, V.
        clock: The cell's clock, at the machine's rate; sample number n is of its time n / rate.

    Raises:
        ConfigurationError: Lab Streaming Layer is not installed.
    """

    def __init__(self, name: str, rate: int, samples: Callable[[int, int], Floats], clock: Clock) -> None:
        lsl = load_lsl()
        info = lsl.StreamInfo(name, "EMG", 1, float(rate), lsl.cf_float32, f"{name}-simulated")
        channel = info.desc().append_child("channels").append_child("channel")
        for key, value in (("label", "FDI"), ("unit", "microvolts"), ("type", "EMG")):
            channel.append_child_value(key, value)
        self._outlet = lsl.StreamOutlet(info)
        self._rate = rate
        self._samples = samples
        self._clock = clock
        self._offset = lsl_minus(clock)
        self._next = self._due()

    async def run(self) -> None:
        """Sends until cancelled."""
        while True:
            await self._clock.sleep(PERIOD)
            self._send()

    def _due(self) -> int:
        """Number of the first sample that is not to be sent yet."""
        return int((self._clock.monotonic() - LATENCY) * self._rate)

    def _send(self) -> None:
        due = self._due()
        first = max(self._next, due - int(CATCH_UP * self._rate))
        if due > first:
            signal = (self._samples(first, due - first) * MICROVOLTS).astype(np.float32)
            newest = (due - 1) / self._rate + self._offset
            self._outlet.push_chunk(signal[:, None], newest)
        self._next = max(due, first)


class PulseInlet:
    """Hears the pulses of another stimulator by its markers.

    Args:
        name: Of the stream of markers.
        stimulate: Called with number, intensity in percent, and time of the cell's clock, s, of each pulse.
        clock: The cell's clock, at the machine's rate.

    Raises:
        ConfigurationError: Lab Streaming Layer is not installed.
    """

    def __init__(self, name: str, stimulate: Callable[[int, float, float], object], clock: Clock) -> None:
        self._inlet = Inlet(name)
        self._stimulate = stimulate
        self._clock = clock
        self._offset = lsl_minus(clock)

    async def run(self) -> None:
        """Hears until cancelled."""
        try:
            while True:
                await self._clock.sleep(PERIOD)
                self._hear()
        finally:
            self._inlet.close()

    def _hear(self) -> None:
        texts, times = self._inlet.pull()
        for text, time in zip(texts, times, strict=True):
            if (marker := read_pulse(text[0])) is not None:
                # A dial that nobody has told of gives no stimulus here.
                self._stimulate(marker.pulse, marker.intensity or 0.0, float(time) - self._offset)
