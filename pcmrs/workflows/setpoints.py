"""Which set points of a teleoperator count. Pure.

Twists of a tool, (6,): velocity (m/s) before angular velocity (rad/s), or a way (m) before a turn (rad). Pure.
"""

from __future__ import annotations

import math
from collections import Counter

import msgspec
import numpy as np

from pcmrs.messages import TeleopSetpoint, TeleopStatus
from pcmrs.messages.teleop import AT_REST, Limit, Twist
from pcmrs.spatial import Floats
from pcmrs.workflows.settings import TeleoperationSettings


def limit_twist(twist: Floats, linear: float, angular: float) -> Floats:
    """A twist (6,), shortened where its translation (m/s) or its rotation (rad/s) is longer than these."""
    excess = max(float(np.linalg.norm(twist[:3])) / linear, float(np.linalg.norm(twist[3:])) / angular)
    return twist / excess if excess > 1.0 else twist


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


class SetpointAdmission:
    """Admits the set points of one engagement, and counts by code what it refuses.

    A set point has to have seen a status of this engagement, so that one of an earlier one is worth nothing here.

    Args:
        user: Who has engaged the clutch.
        started_at: When, s of the daemon's clock.
        settings: Of teleoperation.

    Attributes:
        twist: That of the newest set point.
        sequence: Its number; 0 for none.
        arrived: When it came, s of the daemon's clock; None for none.
        latency: Of those admitted.
        scale: What that leaves of the speed.
        refused: Code to how many.
    """

    def __init__(self, user: str, started_at: float, settings: TeleoperationSettings) -> None:
        self._started_at = started_at
        self.user = user
        self.twist: Twist = AT_REST
        self.sequence = 0
        self.arrived: float | None = None
        self.latency = Latency()
        self.scale = SpeedScale(settings)
        self.refused: Counter[str] = Counter()

    def take(self, user: str, setpoint: TeleopSetpoint, arrived: float) -> None:
        """Takes a set point of a user that has arrived now, s of the daemon's clock."""
        code = self._rejection_code(user, setpoint, arrived)
        if code is not None:
            self.refused[code] += 1
            return
        self.twist, self.sequence, self.arrived = setpoint.twist, setpoint.sequence, arrived
        self.latency.take(arrived, setpoint.sent, setpoint.seen)
        self.scale.take(self.latency.delay, at_rest=setpoint.twist == AT_REST)

    def add_to(self, status: TeleopStatus, limit: Limit | None) -> TeleopStatus:
        """A status with what is known of the set points, and what the tool has come to."""
        return msgspec.structs.replace(
            status,
            user=self.user,
            sequence=self.sequence,
            round_trip=self.latency.round_trip,
            jitter=None if self.latency.round_trip is None else self.latency.jitter,
            scale=self.scale.value,
            held=self.scale.held,
            limit=limit,
            refused=dict(self.refused),
        )

    def _rejection_code(self, user: str, setpoint: TeleopSetpoint, arrived: float) -> str | None:
        if user != self.user:
            return "other_user"
        if not all(map(math.isfinite, (setpoint.sent, setpoint.seen, setpoint.ttl, *setpoint.twist))):
            return "not_finite"
        if setpoint.seen > arrived:
            return "from_the_future"
        if setpoint.seen < self._started_at:
            return "before_engagement"
        if setpoint.sequence <= self.sequence:
            return "out_of_sequence"
        if arrived - setpoint.seen > setpoint.ttl:
            return "expired"
        return None
