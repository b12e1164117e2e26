"""Requests to an arm, and its states and results."""

from __future__ import annotations

from typing import Literal

from pcmrs.messages._base import Message
from pcmrs.messages.device import ActToken


class JointState(Message, frozen=True, kw_only=True):
    """Measured joints, base to flange.

    Attributes:
        captured: Time of the measurement, s of the sender's monotonic clock.
        sent: Time of publication, s of the sender's monotonic clock.
        positions: Joint positions, rad, (n,).
        velocities: Joint velocities, rad/s, (n,).
        torques: Joint torques, N m, (n,).
        moving: True if the arm moves.
        flange_force: External force on the tool along the flange's axes, without its weight, N; None if the arm has no
            estimate.
        relieving: True while the tool moves back along its axis, by a bounded travel, because of a force on it.
    """

    captured: float
    sent: float
    positions: list[float]
    velocities: list[float]
    torques: list[float]
    moving: bool = False
    flange_force: tuple[float, float, float] | None = None
    relieving: bool = False


REST_TIME = 0.2
"""Longest time that an arm needs besides each segment of a motion in segments, s: to settle, and to get the next."""


class JointTrajectory(Message, frozen=True, kw_only=True):
    """Joint positions at a fixed period, starting with the present posture.

    Attributes:
        period: Time between two postures, s.
        positions: Postures, rad, (N, n).
        stops: Indices of the postures in which the arm rests, ascending, the last posture included; empty for a motion
            that rests at its end only.
    """

    period: float
    positions: list[list[float]]
    stops: list[int] = []

    @property
    def duration(self) -> float:
        """Longest duration of the motion, s."""
        return self.period * len(self.positions) + REST_TIME * len(self.stops)


MotionOutcome = Literal["done", "stopped"]
"""How a motion ended: at its end, or held on the way."""


class MotionResult(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Outcome of a motion.

    Attributes:
        outcome: ``done``, or ``stopped`` before its end.
        positions: Measured joints at the end, rad, (n,).
        reason: Reason why it was stopped: ``held``, ``force_limit``, or a reason of this kind of motion.
        force: Force of the tool at the end, N; only after `Robot.press`.
    """

    outcome: MotionOutcome
    positions: list[float]
    reason: str | None = None
    force: float | None = None


class ServoSession(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A stream of set points that a robot has agreed to follow.

    Attributes:
        session: Number of the session, which every set point carries; grows with each session.
        deadman: Time without a fresh set point after which the robot brakes by itself, s of the cell.
    """

    session: int
    deadman: float


class JointSetpoint(Message, frozen=True, kw_only=True):
    """Set point of the joints, base to flange.

    Attributes:
        session: Number of the `ServoSession`; set points of another session are dropped.
        number: Number that grows within a session; a set point that is not newer than the last is dropped.
        sent: Time of sending, s of the sender's monotonic clock.
        positions: Joint positions at `sent`, rad, (n,).
        velocities: Joint velocities at `sent`, rad/s, (n,).
        token: Sessions and hold epoch for which it was made; None inside a node.
    """

    session: int
    number: int
    sent: float
    positions: list[float]
    velocities: list[float]
    token: ActToken | None = None


class PressRequest(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Request to press the tool gently against the body.

    Attributes:
        force: Target force, N, 1 to 5.
        direction_in_flange: Unit vector of the motion and the press in the flange's axes.
        travel: Longest travel along it, m, 0.010 at most.
        speed: Greatest speed along it, m/s.
        timeout: Longest duration, s of the cell, 20 at most.
    """

    force: float
    direction_in_flange: tuple[float, float, float]
    travel: float
    speed: float
    timeout: float
