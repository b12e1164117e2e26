"""Set points of a teleoperator: which are admitted, how late they are, and the speed that this leaves the tool. Pure.

A twist of a tool, (6,), is a velocity (m/s) before an angular velocity (rad/s), or a translation (m) before a rotation
vector (rad).
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
    """Return a twist (6,) shortened to limits, with its direction unchanged.

    Args:
        twist: Twist, (6,).
        linear: Greatest norm of its translation, m or m/s.
        angular: Greatest norm of its rotation, rad or rad/s.
    """
    excess = max(float(np.linalg.norm(twist[:3])) / linear, float(np.linalg.norm(twist[3:])) / angular)
    return twist / excess if excess > 1.0 else twist


JITTER_GAIN = 1.0 / 16.0
"""Gain of the jitter estimator of RFC 3550, section 6.4.1."""


class Latency:
    """Round trip and jitter of set points, measured without synchronized clocks.

    The round trip is measured by the daemon's own clock, from a stamp that it published to the set point whose sender
    had seen that stamp. It includes the time that the stamp waited at the sender, so that it is never too small. The
    jitter is that of RFC 3550, 6.4.1, from differences of the sender's stamps and of the times of arrival.

    Attributes:
        round_trip: Round trip of the newest set point, s; None before the first.
        jitter: Jitter of the set points, s.
    """

    def __init__(self) -> None:
        self.round_trip: float | None = None
        self.jitter = 0.0
        self._transit: float | None = None

    @property
    def delay(self) -> float:
        """Sum of round trip and jitter, s; 0 before the first set point."""
        return 0.0 if self.round_trip is None else self.round_trip + self.jitter

    def take(self, arrived: float, sent: float, seen: float) -> None:
        """Take the stamps of a set point.

        Args:
            arrived: Time of arrival, s of the daemon's clock.
            sent: Time of sending, s of the sender's clock.
            seen: Newest stamp that the sender had seen, s of the daemon's clock.
        """
        self.round_trip = arrived - seen
        transit = arrived - sent  # the offset of the clocks cancels in the difference
        if self._transit is not None:
            self.jitter += JITTER_GAIN * (abs(transit - self._transit) - self.jitter)
        self._transit = transit


class SpeedScale:
    """Scale of the speed: full up to one delay, zero from another delay on, linear in between.

    After a stop, the tool moves again only when the teleoperator has released the controls once.

    Args:
        settings: Settings of teleoperation.

    Attributes:
        held: True if the delay was too long, and no set point at rest has arrived since it became shorter.
    """

    def __init__(self, settings: TeleoperationSettings) -> None:
        self._slow, self._longest = settings.slow_delay, settings.longest_delay
        self._scale = 1.0
        self.held = False

    @property
    def value(self) -> float:
        """Share of the speed that is available, 0 to 1."""
        return 0.0 if self.held else self._scale

    def take(self, delay: float, *, at_rest: bool) -> None:
        """Take the delay of a set point.

        Args:
            delay: Sum of round trip and jitter, s.
            at_rest: True if the set point commands rest.
        """
        self._scale = min(1.0, max(0.0, (self._longest - delay) / (self._longest - self._slow)))
        if delay >= self._longest:
            self.held = True
        elif at_rest:
            self.held = False


class SetpointAdmission:
    """Admission of the set points of one engagement, with a count of the refused ones.

    The sender of a set point must have seen a status of this engagement, so that set points of an earlier engagement
    are refused.

    Args:
        user: User who has engaged the clutch.
        started_at: Time of the engagement, s of the daemon's clock.
        settings: Settings of teleoperation.

    Attributes:
        user: User who has engaged the clutch.
        twist: Twist of the newest set point.
        sequence: Number of the newest set point; 0 before the first.
        arrived: Time of its arrival, s of the daemon's clock; None before the first.
        latency: Latency of the admitted set points.
        scale: Scale of the speed by that latency.
        refused: Number of refused set points by code.
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
        """Admit or refuse a set point that has just arrived.

        Args:
            user: User who has sent the set point.
            setpoint: Set point.
            arrived: Time of arrival, s of the daemon's clock.
        """
        code = self._rejection_code(user, setpoint, arrived)
        if code is not None:
            self.refused[code] += 1
            return
        self.twist, self.sequence, self.arrived = setpoint.twist, setpoint.sequence, arrived
        self.latency.take(arrived, setpoint.sent, setpoint.seen)
        self.scale.take(self.latency.delay, at_rest=setpoint.twist == AT_REST)

    def add_to(self, status: TeleopStatus, limit: Limit | None) -> TeleopStatus:
        """Return a status with the state of the set points added.

        Args:
            status: Status of the tool.
            limit: Limit that the tool has reached, if any.
        """
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
        """Return the code for which a set point is refused; None to admit it."""
        if user != self.user:
            return "other_user"
        if not all(map(math.isfinite, (setpoint.sent, setpoint.seen, setpoint.ttl, *setpoint.twist))):
            return "not_finite"
        # No sender can have seen a status of the future.
        if setpoint.seen > arrived:
            return "from_the_future"
        if setpoint.seen < self._started_at:
            return "before_engagement"
        if setpoint.sequence <= self.sequence:
            return "out_of_sequence"
        if arrived - setpoint.seen > setpoint.ttl:
            return "expired"
        return None
