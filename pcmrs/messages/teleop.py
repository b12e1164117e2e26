"""Set points of a teleoperator, and the status that the daemon publishes."""

from __future__ import annotations

from typing import Final, Literal

from pcmrs.messages._base import Message

Twist = tuple[float, float, float, float, float, float]
"""Velocity of the tool along the axes of its frame, m/s, and about them, rad/s; +z points away from the body."""

AT_REST: Final[Twist] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

Limit = Literal["height", "range", "turn", "zone", "reach"]
"""Limit that keeps the tool from moving as requested.

It is the planned contact, the distance or rotation from the planned pose, a zone that the arm keeps out of, or the
limit of a joint.
"""


class TeleopSetpoint(Message, frozen=True, kw_only=True):
    """Requested motion of the tool until the next set point.

    Attributes:
        sequence: Number that grows with every set point; one that is not newer than the last is refused.
        sent: Time of sending, s of the sender's monotonic clock; only differences are used.
        seen: `TeleopStatus.stamp` of the newest status that the sender has received, s of the daemon's clock.
        ttl: Age of `seen` beyond which the set point is refused, s.
        twist: Requested velocity of the tool, see `Twist`.
    """

    sequence: int
    sent: float
    seen: float
    ttl: float
    twist: Twist


class TeleopStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Status of the guidance, published while the tool is guided.

    Attributes:
        stamp: Time of the daemon's monotonic clock, s; see `TeleopSetpoint.seen`.
        user: User who has engaged the clutch; None while it is open.
        sequence: Number of the last admitted set point; 0 for none.
        round_trip: Time from `stamp` to the arrival of the set point that has seen it, s; None before the first.
        jitter: Jitter of the set points' arrival, s (RFC 3550, 6.4.1).
        scale: Factor on the speed because of the delay, 0 to 1.
        held: True if the delay was too long: the tool stands until a set point requests no motion.
        distance: Distance of the tool point from its planned position, m.
        height: Height of the tool point above the planned contact, m.
        turn: Rotation of the tool from its planned pose, rad.
        limit: Limit that the tool has reached; None for none.
        refused: Number of set points that were refused since the clutch was engaged, by code.
    """

    stamp: float
    user: str | None = None
    sequence: int = 0
    round_trip: float | None = None
    jitter: float | None = None
    scale: float = 1.0
    held: bool = False
    distance: float | None = None
    height: float | None = None
    turn: float | None = None
    limit: Limit | None = None
    refused: dict[str, int] = {}
