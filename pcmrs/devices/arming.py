"""Whether a stimulator may fire, and which pulse was the last: the rules that every driver keeps."""

from __future__ import annotations

import math

from pcmrs.errors import DeviceError
from pcmrs.messages import DeviceEvent


class Arming:
    """The armed state of a stimulator and the numbers of its pulses.

    Args:
        longest: Time after which it disarms when no pulse was given, s.

    Attributes:
        armed: Whether it can fire.
        pulse: Number of the last pulse; it outlives every disarming and every link.
    """

    def __init__(self, longest: float) -> None:
        self._longest = longest
        self._since = 0.0
        self.armed = False
        self.pulse = 0

    def arm(self, now: float) -> None:
        """It can fire from now on; `now` is of the cell's clock, s."""
        self.armed, self._since = True, now

    def disarm(self) -> None:
        """It cannot fire any more."""
        self.armed = False

    def expired(self, now: float) -> bool:
        """Whether it has been armed for too long without a pulse."""
        return self.armed and now - self._since >= self._longest

    def expiry(self) -> DeviceEvent:
        """Disarms it for that, and says so."""
        return self.disarmed(f"No pulse was given for {self._longest:g} s")

    def disarmed(self, why: str) -> DeviceEvent:
        """Disarms it without being asked, and says so."""
        self.disarm()
        text = f"{why}: the stimulator has disarmed. Arm it again."
        return DeviceEvent(device="stimulator", code="disarmed", text=text)

    def check(self, number: int) -> None:
        """Checks that the pulse `number` may be given.

        Raises:
            DeviceError: It is not armed, or a pulse of this or a later number was given before.
        """
        if number <= self.pulse:
            raise DeviceError(
                f"Pulse {number} is refused: pulse {self.pulse} was given already. Number the next one higher.",
                number=number,
                last=self.pulse,
            )
        if not self.armed:
            raise DeviceError(f"Pulse {number} is refused: the stimulator is not armed. Arm it.", number=number)

    def take(self, number: int, now: float) -> None:
        """Uses the number up, before the pulse is given: whatever happens then, it is not given twice."""
        self.pulse, self._since = number, now


def check_intensity(percent: float) -> float:
    """An intensity in percent of the maximum stimulator output.

    Raises:
        DeviceError: It is not from 0 to 100.
    """
    if not (math.isfinite(percent) and 0.0 <= percent <= 100.0):
        raise DeviceError(f"An intensity of {percent:g} % cannot be set; it goes from 0 to 100 %.", percent=percent)
    return percent
