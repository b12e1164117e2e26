"""Trigger line of a stimulator on a serial port: a byte, or a pulse on one of the port's control lines.

Written for RS-232 ports and USB adapters that `pyserial` opens, and for boxes that convert a byte into a TTL pulse. Not
tested on hardware.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Literal

from pcmrs.clock import Clock
from pcmrs.errors import ConfigurationError, DeviceError, UnknownOutcomeError

Signal = Literal["byte", "dtr", "rts"]

LONGEST_WRITE = 0.1
"""Longest time in which the port accepts the byte, s; one byte fits into its buffer at once."""


class TriggerLine:
    """A serial port that triggers a stimulator.

    Opening a port pulses DTR and RTS of many adapters: disarm the stimulator itself before.

    Args:
        port: Path of the port, such as ``/dev/ttyUSB0``.
        signal: ``byte`` sends a byte; ``dtr`` and ``rts`` raise that line for `width`.
        byte: Byte to send, 0 to 255.
        baud: Baud rate of the port.
        width: Width of the pulse on a line, s.

    Raises:
        ConfigurationError: The library for serial ports is not installed.
    """

    def __init__(self, port: str, signal: Signal, byte: int, baud: int, width: float) -> None:
        try:
            import serial
        except ImportError:
            raise ConfigurationError(
                "A trigger on a serial port needs pyserial: install the extra hardware (docs/supply.md)."
            ) from None
        self._serial: Any = serial.Serial(baudrate=baud, write_timeout=LONGEST_WRITE)
        self._serial.port = port
        self._failures = (OSError, serial.SerialException)
        self._signal = signal
        self._byte = byte
        self._width = width

    def open(self) -> None:
        """Open the port with its lines low, unless it is open.

        Raises:
            DeviceError: The port cannot be opened.
        """
        if self._serial.is_open:
            return
        try:
            if self._signal != "byte":
                self._serial.dtr = self._serial.rts = False
            self._serial.open()
        except self._failures as error:
            raise DeviceError(
                f"The trigger's port {self._serial.port} cannot be opened ({error}); connect it, and arm again.",
                port=self._serial.port,
            ) from None

    async def pulse(self, clock: Clock) -> None:
        """Trigger the stimulator.

        Raises:
            UnknownOutcomeError: The port failed, before or after the trigger.
        """
        try:
            if self._signal == "byte":
                self._serial.write(bytes([self._byte]))
                return
            try:
                setattr(self._serial, self._signal, True)
                await clock.sleep(self._width)
            finally:
                setattr(self._serial, self._signal, False)
        except self._failures as error:
            self.close()
            raise UnknownOutcomeError(
                f"The trigger's port {self._serial.port} failed while the pulse was given ({error}): look at the "
                "stimulator's own counter; then arm again.",
                port=self._serial.port,
            ) from None

    def close(self) -> None:
        """Close the port."""
        with suppress(*self._failures):
            self._serial.close()
