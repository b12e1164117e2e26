"""From the stamps of a sender's monotonic clock to the wall's time, which ROS stamps with."""

from __future__ import annotations

from pcmrs.clock import Clock
from pcmrs.devices.lateness import Lateness

_LONGEST = 60.0


class Stamps:
    """The wall's time of what one sender measured.

    How long ago it was comes from the sender's own stamps; what the way from there took beyond the quickest message is
    taken off, so that two messages that arrive together do not seem to be of one moment.

    Args:
        clock: Of the cell.
        rate: Seconds of that clock per second of the machine.
    """

    def __init__(self, clock: Clock, rate: float) -> None:
        self._clock = clock
        self._rate = rate
        self._lateness = Lateness()

    def of(self, captured: float, sent: float) -> float:
        """Unix seconds of a measurement.

        Args:
            captured: When it was made, s of the sender's clock.
            sent: When it was sent; a sender without sense counts as one that measures and sends at once.
        """
        late = self._lateness.hear(sent, self._clock.monotonic())
        age = sent - captured
        known = age if 0.0 <= age < _LONGEST else 0.0
        return self._clock.wall() - (known + late) / self._rate
