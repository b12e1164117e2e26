"""Driver of an electromyograph on Lab Streaming Layer, with the stimulator's pulses as markers on another stream.

Written from liblsl 1.18 (pylsl); tested against outlets of the same library, not tested on hardware. Epochs are cut by
the time stamps of both streams, each corrected by the library's estimate of its clock's offset (below 1 ms, and far
less on one machine). The delay of the amplifier and its software before they stamp a sample is unknown here.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Collection, Mapping
from contextlib import asynccontextmanager, suppress
from typing import Annotated, Any

import msgspec
import numpy as np

from pcmrs.background import background_task
from pcmrs.clock import Clock
from pcmrs.devices.lsl.epochs import LONGEST, SignalBuffer, check_window
from pcmrs.devices.lsl.inlet import Inlet
from pcmrs.devices.lsl.library import EMG, StreamName, load_lsl
from pcmrs.devices.lsl.markers import PULSES, read_pulse
from pcmrs.devices.tables import check_devices, read_table
from pcmrs.errors import DeviceError
from pcmrs.messages import Epoch

Positive = Annotated[float, msgspec.Meta(gt=0.0)]

READ_PERIOD = 0.01
"""Time between two readings of both streams, s."""

STORED = 2.0 * LONGEST
"""Duration of signal and markers that are stored, s: an epoch is requested right after its pulse."""

GRACE = 0.5
"""Longest wait for an epoch after its last sample was due, s."""


class LslSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table ``lsl`` of the configuration.

    If the lab's network requires it, Lab Streaming Layer itself is configured by its own file ``lsl_api.cfg``.

    Attributes:
        stream: Name of the amplifier's stream.
        type: Type of that stream; None for any.
        channel: Channel of that stream, from 0.
        muscle: Muscle under the electrodes of that channel.
        volts_per_unit: Unit of the stream's numbers, V; most amplifiers send uV.
        full_scale: Magnitude at which the amplifier saturates, V; 0 if it is unknown.
        jitter: Greatest deviation of time stamps from an even spacing, s; more means that samples are missing.
        markers: Name of the stream with the markers of the stimulator's pulses.
    """

    stream: StreamName = EMG
    type: StreamName | None = "EMG"
    channel: Annotated[int, msgspec.Meta(ge=0)] = 0
    muscle: str = "FDI"
    volts_per_unit: Positive = 1e-6
    full_scale: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0
    jitter: Positive = 0.002
    markers: StreamName = PULSES


class LslEmg:
    """Implementation of `pcmrs.devices.protocols.Emg`.

    Args:
        settings: Streams and channel.
        clock: Clock of the machine: streams of a lab run in real time.

    Raises:
        ConfigurationError: Lab Streaming Layer is not installed.
    """

    def __init__(self, settings: LslSettings, clock: Clock) -> None:
        self._settings = settings
        self._clock = clock
        self._signal = Inlet(settings.stream, settings.type or "")
        self._markers = Inlet(settings.markers)
        self._lsl = load_lsl()
        self._info: Any = None
        self._recording: SignalBuffer | None = None
        self._pulses: dict[int, float] = {}
        self._unusable = ""
        self._updated = asyncio.Event()

    async def epoch(self, pulse: int, before: float, after: float) -> Epoch:
        check_window(before, after)
        with suppress(TimeoutError):
            async with self._clock.timeout(after + GRACE):
                while not self._measured(pulse, after):
                    await self._updated.wait()
        return self._cut(pulse, before, after)

    async def read(self) -> None:
        """Read both streams until cancelled."""
        try:
            while True:
                self._read_markers()
                self._read_signal()
                self._updated.set()
                self._updated.clear()
                await self._clock.sleep(READ_PERIOD)
        finally:
            self._signal.close()
            self._markers.close()

    def _read_markers(self) -> None:
        texts, times = self._markers.pull()
        for text, time in zip(texts, times, strict=True):
            if (marker := read_pulse(text[0])) is not None:
                self._pulses[marker.pulse] = float(time)
        oldest = self._lsl.local_clock() - STORED  # numbers repeat in another session
        self._pulses = {number: time for number, time in self._pulses.items() if time > oldest}

    def _read_signal(self) -> None:
        samples, times = self._signal.pull()
        if self._signal.info is not self._info:
            self._begin(self._signal.info)
        if self._recording is not None and len(times):
            self._recording.add(times, samples[:, self._settings.channel] * self._settings.volts_per_unit)

    def _begin(self, info: Any) -> None:
        """Start a new buffer for a stream that was found: it may be another one than before."""
        self._info, self._recording, self._unusable = info, None, ""
        rate, count, channel = info.nominal_srate(), info.channel_count(), self._settings.channel
        name = f"The stream {self._settings.stream!r}"
        if not rate > 0.0 or info.channel_format() == self._lsl.cf_string:
            self._unusable = f"{name} has no numbers at a fixed rate; configure the amplifier's own stream"
        elif channel >= count:
            self._unusable = f"{name} has {count} channels; lsl.channel = {channel} is not among 0 to {count - 1}"
        else:
            self._recording = SignalBuffer(rate, STORED, self._settings.jitter)

    def _measured(self, pulse: int, after: float) -> bool:
        """Return True if the epoch is complete."""
        time = self._pulses.get(pulse)
        return time is not None and self._recording is not None and self._recording.end >= time + after

    def _cut(self, pulse: int, before: float, after: float) -> Epoch:
        time = self._pulses.get(pulse)
        recording = self._recording
        if time is None:
            why = self._markers.problem or f"no marker of it arrived on the stream {self._settings.markers!r}"
            raise DeviceError(f"Pulse {pulse} has no epoch: {why}.", pulse=pulse)
        if recording is None or recording.end < time + after:
            why = self._unusable or self._signal.problem or f"the stream {self._settings.stream!r} sends nothing"
            raise DeviceError(f"Pulse {pulse} has no epoch: {why}.", pulse=pulse)
        start, samples = recording.cut(time - before, time + after)
        return Epoch(
            pulse=pulse,
            muscle=self._settings.muscle,
            rate_hz=recording.rate,
            start=start - time,
            samples=np.asarray(samples).tolist(),
            full_scale=self._settings.full_scale or None,
        )


@asynccontextmanager
async def open_devices(
    devices: Collection[str], settings: Mapping[str, Any], clock: Clock
) -> AsyncIterator[Mapping[str, Any]]:
    """Open the electromyograph; see `pcmrs.devices.protocols.OpenDriver`.

    Args:
        devices: Only ``emg``.
        settings: Whole configuration as plain data; ``lsl`` is read.
        clock: Clock of the machine.

    Raises:
        ConfigurationError: Another device is requested, the table ``lsl`` is wrong, or the library is missing.
    """
    check_devices("lsl", devices, "emg")
    emg = LslEmg(read_table(settings, "lsl", LslSettings), clock)
    async with background_task(emg.read(), "lsl"):
        yield {"emg": emg}
