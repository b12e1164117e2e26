"""Driver of a triggered stimulator: pulses as markers of Lab Streaming Layer and, if configured, on a serial port.

Such a stimulator reports nothing: it counts as ready when it is armed here, the temperature of its coil is unknown, and
its intensity is the one that the operator has dialled. Written from liblsl 1.18 (pylsl) and pyserial 3.5; not tested on
hardware.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Collection, Mapping
from contextlib import asynccontextmanager, closing
from typing import Annotated, Any

import msgspec
import structlog

from pcmrs.background import background_task
from pcmrs.clock import Clock
from pcmrs.devices._ttl import Signal, TriggerLine
from pcmrs.devices.arming import Arming, check_intensity
from pcmrs.devices.lsl.library import StreamName
from pcmrs.devices.lsl.markers import PULSES, MarkerOutlet, PulseMarker
from pcmrs.devices.stream import Stream
from pcmrs.devices.tables import check_devices, read_table
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.messages import DeviceEvent, FiredPulse, StimulatorState

WATCH_PERIOD = 0.1
"""Time between two checks of how long it has been armed, s of the clock."""

log = structlog.get_logger(__name__)


class TriggerSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The table ``trigger`` of the configuration.

    Attributes:
        markers: Name of the stream with the markers of the pulses; each cell on a network needs its own.
        dialled: True if the operator turns the stimulator's dial to each requested intensity before the pulse. Only
            then can intensities be set.
        armed_time: Time without a pulse after which it disarms, s.
        port: Serial port of the trigger, such as ``/dev/ttyUSB0``; empty for markers alone.
        signal: Trigger on the port: a ``byte``, or a pulse on its line ``dtr`` or ``rts``.
        byte: Byte that triggers.
        baud: Baud rate of the port.
        width: Width of the pulse on a line, s.
    """

    markers: StreamName = PULSES
    dialled: bool = False
    armed_time: Annotated[float, msgspec.Meta(gt=0.0)] = 60.0
    port: str = ""
    signal: Signal = "byte"
    byte: Annotated[int, msgspec.Meta(ge=0, le=255)] = 1
    baud: Annotated[int, msgspec.Meta(gt=0)] = 115200
    width: Annotated[float, msgspec.Meta(gt=0.0, le=0.1)] = 0.01


class TriggerStimulator:
    """Implementation of `pcmrs.devices.protocols.StimulatorDriver`.

    Args:
        settings: Stream of markers, and trigger port.
        clock: Clock of the cell.

    Raises:
        ConfigurationError: A required library is not installed.
    """

    def __init__(self, settings: TriggerSettings, clock: Clock) -> None:
        self._clock = clock
        self._dialled = settings.dialled
        self._outlet = MarkerOutlet(settings.markers)
        self._line = None
        if settings.port:
            self._line = TriggerLine(settings.port, settings.signal, settings.byte, settings.baud, settings.width)
        self._arming = Arming(settings.armed_time)
        self._intensity: float | None = None
        self._events: Stream[DeviceEvent] = Stream()

    async def state(self) -> StimulatorState:
        armed = self._arming.armed
        return StimulatorState(
            armed=armed, ready=armed, intensity=self._intensity, coil_temperature=None, pulse=self._arming.pulse
        )

    async def set_intensity(self, percent: float) -> StimulatorState:
        if not self._dialled:
            raise DeviceError(
                f"{check_intensity(percent):g} % cannot be set: this stimulator has a dial. If the operator turns it "
                "to each requested intensity, set trigger.dialled = true."
            )
        self._intensity = check_intensity(percent)
        return await self.state()

    async def arm(self) -> StimulatorState:
        if self._line is not None:
            self._line.open()
        self._arming.arm(self._clock.monotonic())
        return await self.state()

    async def disarm(self) -> StimulatorState:
        self._arming.disarm()
        return await self.state()

    async def fire(self, number: int) -> FiredPulse:
        self._arming.check(number)
        fired = self._clock.monotonic()
        self._arming.take(number, fired)
        self._outlet.push(PulseMarker(number, self._intensity).text)
        if self._line is not None:
            await self._trigger(self._line)
        return FiredPulse(number=number, intensity=self._intensity, fired=fired)

    def events(self) -> AsyncIterator[DeviceEvent]:
        return self._events.read()

    async def watch(self) -> None:
        """Open the port, then disarm after each `armed_time` without a pulse, until cancelled."""
        if self._line is not None:
            try:
                self._line.open()
            except DeviceError as error:
                log.warning("trigger_absent", reason=error.text)
        while True:
            await self._clock.sleep(WATCH_PERIOD)
            if self._arming.expired(self._clock.monotonic()):
                self._events.publish(self._arming.expiry())

    def close(self) -> None:
        """Disarm, close the port and end all readers."""
        self._arming.disarm()
        self._events.close()
        if self._line is not None:
            self._line.close()

    async def _trigger(self, line: TriggerLine) -> None:
        try:
            await line.pulse(self._clock)
        except UnknownOutcomeError:
            self._events.publish(self._arming.disarmed("The trigger's port failed"))
            raise


@asynccontextmanager
async def open_devices(
    devices: Collection[str], settings: Mapping[str, Any], clock: Clock
) -> AsyncIterator[Mapping[str, Any]]:
    """Open the stimulator; see `pcmrs.devices.protocols.OpenDriver`.

    Args:
        devices: Only ``stimulator``.
        settings: Whole configuration as plain data; ``trigger`` is read.
        clock: Clock of the cell.

    Raises:
        ConfigurationError: Another device is requested, the table ``trigger`` is wrong, or a library is missing.
    """
    check_devices("trigger", devices, "stimulator")
    with closing(TriggerStimulator(read_table(settings, "trigger", TriggerSettings), clock)) as stimulator:
        async with background_task(stimulator.watch(), "trigger"):
            yield {"stimulator": stimulator}
