"""One trigger line of a stimulator on a serial port: a byte, or a pulse on one of the port's control lines.

Written for RS-232 ports and USB adapters that `pyserial` opens, and boxes that turn a byte into a TTL pulse; not tested
on hardware.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Literal

from pcmrs.clock import Clock
from pcmrs.errors import ConfigurationError, DeviceError, UnknownOutcomeError

Signal = Literal["byte", "dtr", "rts"]

LONGEST_WRITE = 0.1
"""Seconds that the port may take to accept the byte; one byte goes into its buffer at once."""


class TriggerLine:
    """A serial port that triggers a stimulator.

    Opening a port pulses DTR and RTS of many adapters: have the stimulator itself disarmed then.

    Args:
        port: Such as ``/dev/ttyUSB0``.
        signal: ``byte`` sends one; ``dtr`` and ``rts`` raise that line for `width`.
        byte: What is sent, 0 to 255.
        baud: Of the port.
        width: Of the pulse on a line, s.

    Raises:
        ConfigurationError: The library for serial ports is not installed.
    """

    def __init__(self, port: str, signal: Signal, byte: int, baud: int, width: float) -> None:
        try:
            import serial
        except ImportError:
            raise ConfigurationError(
                "A trigger on a serial port needs pyserial; install the extra `hardware`: "
                "install the extra hardware (docs/supply.md)."
            ) from None
        self._serial: Any = serial.Serial(baudrate=baud, write_timeout=LONGEST_WRITE)
        self._serial.port = port
        self._failures = (OSError, serial.SerialException)
        self._signal = signal
        self._byte = byte
        self._width = width

    def open(self) -> None:
        """Opens the port with its lines low, if it is not open.

        Raises:
            DeviceError: It cannot be opened.
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
        """Triggers the stimulator.

        Raises:
            UnknownOutcomeError: The port failed; nobody can say whether it did so before or after the trigger.
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
        """Closes the port."""
        with suppress(*self._failures):
            self._serial.close()
