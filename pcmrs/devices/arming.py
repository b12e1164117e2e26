"""Arming of a stimulator and numbering of its pulses: the rules that every driver follows."""

from __future__ import annotations

import math

from pcmrs.errors import DeviceError
from pcmrs.messages import DeviceEvent


class Arming:
    """The armed state of a stimulator and the numbers of its pulses.

    Args:
        longest: Time without a pulse after which the stimulator disarms, s.

    Attributes:
        armed: True if the stimulator can fire.
        pulse: Number of the last pulse; disarming and a lost link do not reset it.
    """

    def __init__(self, longest: float) -> None:
        self._longest = longest
        self._armed_at = 0.0
        self.armed = False
        self.pulse = 0

    def arm(self, now: float) -> None:
        """Arm at the time `now`, s of the cell's clock."""
        self.armed, self._armed_at = True, now

    def disarm(self) -> None:
        """Disarm."""
        self.armed = False

    def expired(self, now: float) -> bool:
        """Return True if it has been armed for too long without a pulse at the time `now`, s of the cell's clock."""
        return self.armed and now - self._armed_at >= self._longest

    def expiry(self) -> DeviceEvent:
        """Disarm because no pulse was given, and return the event that reports it."""
        return self.disarmed(f"No pulse was given for {self._longest:g} s")

    def disarmed(self, why: str) -> DeviceEvent:
        """Disarm without a request, and return the event that reports the reason `why`."""
        self.disarm()
        text = f"{why}: the stimulator has disarmed. Arm it again."
        return DeviceEvent(device="stimulator", code="disarmed", text=text)

    def check(self, number: int) -> None:
        """Check that the pulse `number` may be given.

        Raises:
            DeviceError: The stimulator is not armed, or a pulse with this or a higher number was given before.
        """
        if number <= self.pulse:
            raise DeviceError(
                f"Pulse {number} is refused: pulse {self.pulse} was given already. Use a higher number.",
                number=number,
                last=self.pulse,
            )
        if not self.armed:
            raise DeviceError(f"Pulse {number} is refused: the stimulator is not armed. Arm it.", number=number)

    def take(self, number: int, now: float) -> None:
        """Record a pulse before it is given, so that it is never given twice, whatever happens then.

        Args:
            number: Number of the pulse.
            now: Time, s of the cell's clock.
        """
        self.pulse, self._armed_at = number, now


def check_intensity(percent: float) -> float:
    """Return an intensity if it can be set, in percent of the maximum stimulator output.

    Raises:
        DeviceError: The intensity is not from 0 to 100.
    """
    if not (math.isfinite(percent) and 0.0 <= percent <= 100.0):
        raise DeviceError(f"An intensity of {percent:g} % cannot be set; the range is 0 to 100 %.", percent=percent)
    return percent
