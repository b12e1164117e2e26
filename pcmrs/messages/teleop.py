"""What a teleoperator sends, and what the daemon tells of it."""

from __future__ import annotations

from typing import Final, Literal

from pcmrs.messages.base import Message

Twist = tuple[float, float, float, float, float, float]
"""Velocity of the tool along the axes of its own frame, m/s, and about them, rad/s; +z points away from the body."""

AT_REST: Final[Twist] = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)

Limit = Literal["height", "range", "turn", "zone", "reach"]
"""What keeps the tool from going where it is asked to: the planned contact, its distance or rotation from the planned
pose, what the arm keeps out of, or the end of a joint."""


class TeleopSetpoint(Message, frozen=True, kw_only=True):
    """How a teleoperator wants the tool to move, until the next set point.

    Attributes:
        sequence: Grows with every set point; one that is not newer than the last is refused.
        sent: Sender's monotonic time, s; only differences count.
        seen: `TeleopStatus.stamp` of the newest status that the sender has seen, s: the daemon's own time.
        ttl: The set point is refused when `seen` is older than this, s.
        twist: See `Twist`.
    """

    sequence: int
    sent: float
    seen: float
    ttl: float
    twist: Twist


class TeleopStatus(Message, frozen=True, kw_only=True, omit_defaults=False):
    """How the guiding goes, published for as long as the tool is guided.

    Attributes:
        stamp: Daemon's monotonic time, s; see `TeleopSetpoint.seen`.
        user: Who has engaged the clutch; None while it is open.
        sequence: Of the last set point that was admitted; 0 for none.
        round_trip: From `stamp` to the set point that has seen it, s; None before the first.
        jitter: Of the set points' arrival, s (RFC 3550, 6.4.1).
        scale: What the delay leaves of the speed, 0 to 1.
        held: The delay was too long: the tool stands until a set point asks for no motion.
        distance: Of the tool point from its planned place, m.
        height: Of the tool point above the planned contact, m.
        turn: Of the tool against its planned pose, rad.
        limit: What the tool has come to.
        refused: Code to how many set points were refused for it since the clutch was engaged.
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
