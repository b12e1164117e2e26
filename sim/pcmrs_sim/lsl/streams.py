"""The muscle on Lab Streaming Layer: its electromyogram as a stream out, and pulses as markers in."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pcmrs.clock import Clock
from pcmrs.devices.lsl.inlet import Inlet
from pcmrs.devices.lsl.library import load_lsl
from pcmrs.devices.lsl.markers import read_pulse
from pcmrs.spatial import Floats

PERIOD = 0.01
"""Period of packets, and of polls for markers, s."""
LATENCY = 0.1
"""Age of the newest sample that is sent, s. It stands for an amplifier's buffers, and lets a pulse's marker arrive
before the samples that the pulse changes."""
CATCH_UP = 1.0
"""Age beyond which samples are left out after a stall, s."""
MICROVOLTS = 1e6


def lsl_minus(clock: Clock) -> float:
    """Return the time of Lab Streaming Layer minus the time of a clock, s: constant if both run at the same rate."""
    return float(load_lsl().local_clock() - clock.monotonic())


class EmgOutlet:
    """An electromyogram as a stream that follows a clock.

    Args:
        name: Name of the stream.
        rate: Samples per second, an integer.
        samples: Returns samples, V, by the number of the first one and their count.
        clock: The cell's clock, at the machine's rate. Sample number n belongs to its time n / rate.

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
        """Send until cancelled."""
        while True:
            await self._clock.sleep(PERIOD)
            self._send()

    def _due(self) -> int:
        """Return the number of the first sample that is not due yet."""
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
    """Receiver of the markers of another stimulator.

    Args:
        name: Name of the stream of markers.
        stimulate: Called for each pulse with its number, its intensity (percent of the maximum stimulator output) and
            its time on the cell's clock, s.
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
        """Receive until cancelled."""
        try:
            while True:
                await self._clock.sleep(PERIOD)
                self._poll()
        finally:
            self._inlet.close()

    def _poll(self) -> None:
        texts, times = self._inlet.pull()
        for text, time in zip(texts, times, strict=True):
            if (marker := read_pulse(text[0])) is not None:
                # Without a known intensity, the pulse has no effect here.
                self._stimulate(marker.pulse, marker.intensity or 0.0, float(time) - self._offset)
