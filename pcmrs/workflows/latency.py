"""How late the set points of a teleoperator come, and how much of its speed that leaves the tool. Pure."""

from __future__ import annotations

from pcmrs.workflows.settings import TeleoperationSettings

JITTER_GAIN = 1.0 / 16.0
"""Of the estimator of RFC 3550, section 6.4.1."""


class Latency:
    """Round trip and jitter, without clocks that agree.

    The round trip is measured by the daemon's own clock: from a stamp that it published to the set point whose sender
    had seen it. It contains how long the stamp lay at the sender, so it is never too small. The jitter is that of
    RFC 3550, 6.4.1, from differences of the sender's stamps and differences of arrival.

    Attributes:
        round_trip: Of the newest set point, s; None before the first.
        jitter: s.
    """

    def __init__(self) -> None:
        self.round_trip: float | None = None
        self.jitter = 0.0
        self._transit: float | None = None

    @property
    def delay(self) -> float:
        """Round trip and jitter together, s; 0 before the first set point."""
        return 0.0 if self.round_trip is None else self.round_trip + self.jitter

    def take(self, arrived: float, sent: float, seen: float) -> None:
        """Takes a set point's stamps, s: `arrived` and `seen` are of the daemon's clock, `sent` of the sender's."""
        self.round_trip = arrived - seen
        transit = arrived - sent  # off by what the clocks differ, which cancels in the difference
        if self._transit is not None:
            self.jitter += JITTER_GAIN * (abs(transit - self._transit) - self.jitter)
        self._transit = transit


class SpeedScale:
    """Full speed up to one delay, none from another one on, linear in between; what stood goes on only when let go.

    Args:
        settings: Of teleoperation.

    Attributes:
        held: The delay was too long, and no set point has asked for rest since it is not.
    """

    def __init__(self, settings: TeleoperationSettings) -> None:
        self._slow, self._longest = settings.slow_delay, settings.longest_delay
        self._scale = 1.0
        self.held = False

    @property
    def value(self) -> float:
        """Part of the speed that is left, 0 to 1."""
        return 0.0 if self.held else self._scale

    def take(self, delay: float, *, at_rest: bool) -> None:
        """Takes the delay, s, of a set point, and whether it asks for rest."""
        self._scale = min(1.0, max(0.0, (self._longest - delay) / (self._longest - self._slow)))
        if delay >= self._longest:
            self.held = True
        elif at_rest:
            self.held = False
