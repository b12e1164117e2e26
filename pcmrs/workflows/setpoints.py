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
from pcmrs.workflows.latency import Latency, SpeedScale
from pcmrs.workflows.settings import TeleoperationSettings


def within(twist: Floats, linear: float, angular: float) -> Floats:
    """A twist (6,), shortened where its translation (m/s) or its rotation (rad/s) is longer than these."""
    excess = max(float(np.linalg.norm(twist[:3])) / linear, float(np.linalg.norm(twist[3:])) / angular)
    return twist / excess if excess > 1.0 else twist


class Admission:
    """Admits the set points of one engagement, and counts by code what it refuses.

    A set point has to have seen a status of this engagement, so that one of an earlier one is worth nothing here.

    Args:
        user: Who has engaged the clutch.
        begun: When, s of the daemon's clock.
        settings: Of teleoperation.

    Attributes:
        twist: That of the newest set point.
        sequence: Its number; 0 for none.
        arrived: When it came, s of the daemon's clock; None for none.
        latency: Of those admitted.
        scale: What that leaves of the speed.
        refused: Code to how many.
    """

    def __init__(self, user: str, begun: float, settings: TeleoperationSettings) -> None:
        self._begun = begun
        self.user = user
        self.twist: Twist = AT_REST
        self.sequence = 0
        self.arrived: float | None = None
        self.latency = Latency()
        self.scale = SpeedScale(settings)
        self.refused: Counter[str] = Counter()

    def take(self, user: str, setpoint: TeleopSetpoint, arrived: float) -> None:
        """Takes a set point of a user that has arrived now, s of the daemon's clock."""
        code = self._fault(user, setpoint, arrived)
        if code is not None:
            self.refused[code] += 1
            return
        self.twist, self.sequence, self.arrived = setpoint.twist, setpoint.sequence, arrived
        self.latency.take(arrived, setpoint.sent, setpoint.seen)
        self.scale.take(self.latency.delay, at_rest=setpoint.twist == AT_REST)

    def shown(self, status: TeleopStatus, limit: Limit | None) -> TeleopStatus:
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

    def _fault(self, user: str, setpoint: TeleopSetpoint, arrived: float) -> str | None:
        if user != self.user:
            return "other_user"
        if not all(map(math.isfinite, (setpoint.sent, setpoint.seen, setpoint.ttl, *setpoint.twist))):
            return "not_finite"
        if setpoint.seen > arrived:
            return "from_the_future"
        if setpoint.seen < self._begun:
            return "before_engagement"
        if setpoint.sequence <= self.sequence:
            return "out_of_sequence"
        if arrived - setpoint.seen > setpoint.ttl:
            return "expired"
        return None
