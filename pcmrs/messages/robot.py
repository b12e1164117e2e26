"""What an arm is told, and what it tells."""

from __future__ import annotations

from typing import Literal

from pcmrs.messages.base import Message
from pcmrs.messages.device import ActToken


class JointState(Message, frozen=True, kw_only=True):
    """Measured joints: positions in rad, velocities in rad/s, torques in N m, base to flange.

    Attributes:
        flange_force: External force on what the flange carries, N, along the flange's axes, without its weight;
            None where the arm has no estimate.
        relieving: It goes back along the tool's axis because of a force on the tool, by a bounded way.
    """

    captured: float
    sent: float
    positions: list[float]
    velocities: list[float]
    torques: list[float]
    moving: bool = False
    flange_force: tuple[float, float, float] | None = None
    relieving: bool = False


class JointTrajectory(Message, frozen=True, kw_only=True):
    """Joint positions (rad) at a fixed `period` (s), starting with the present posture."""

    period: float
    positions: list[list[float]]


MotionOutcome = Literal["done", "stopped"]


class MotionResult(Message, frozen=True, kw_only=True, omit_defaults=False):
    """How a motion ended, and the joints (rad) measured then.

    Attributes:
        reason: Why it was stopped: ``held``, ``force_limit``, or a reason of the motion's own.
        force: With which the tool pressed then, N; only after `Robot.press`.
    """

    outcome: MotionOutcome
    positions: list[float]
    reason: str | None = None
    force: float | None = None


class ServoSession(Message, frozen=True, kw_only=True, omit_defaults=False):
    """A stream of set points that a robot has agreed to follow.

    Attributes:
        session: Goes into every set point; grows with each session.
        deadman: The robot brakes by itself when no fresh set point has come for so long, s of the cell.
    """

    session: int
    deadman: float


class JointSetpoint(Message, frozen=True, kw_only=True):
    """Where the joints shall be now (rad) and how fast they shall go there (rad/s), base to flange.

    Attributes:
        session: Of a `ServoSession`; set points of another one are dropped.
        number: Grows within a session; a set point that is not newer than the last is dropped.
        sent: Sender's monotonic time.
        token: For which situation it was made; None inside a node.
    """

    session: int
    number: int
    sent: float
    positions: list[float]
    velocities: list[float]
    token: ActToken | None = None


class PressRequest(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Asks that the tool be pressed gently against the body.

    Attributes:
        force: To press with, N, 1 to 5.
        direction_in_flange: Unit vector along which to go and press, in the flange's axes.
        travel: Farthest way along it, m, 0.010 at most.
        speed: Greatest speed on it, m/s.
        timeout: Longest time, s of the cell, 20 at most.
    """

    force: float
    direction_in_flange: tuple[float, float, float]
    travel: float
    speed: float
    timeout: float
