"""Servo sessions, one after the other: who may send set points, and what becomes of those of others."""

from __future__ import annotations

from pcmrs.devices.motion.follower import Follower
from pcmrs.devices.motion.servo import Servo
from pcmrs.errors import DeviceError
from pcmrs.messages import JointSetpoint, ServoSession


class Sessions:
    """The sessions of one robot, of which one at most runs.

    Attributes:
        servo: Of the session that nobody has ended yet; it may have ended by itself.
        number: Of the last session.
        dropped: Set points that were stale or of no running session.
    """

    def __init__(self) -> None:
        self.servo: Servo | None = None
        self.number = 0
        self.dropped = 0

    def begin(self, follower: Follower) -> ServoSession:
        """Opens one; the arm must be at rest."""
        self.servo = follower.servo()
        self.number += 1
        return ServoSession(session=self.number, deadman=self.servo.deadman)

    def end(self, session: int, follower: Follower) -> None:
        """Ends this one, never a later one; the arm brakes if it has not done so before.

        Raises:
            DeviceError: It is over.
        """
        if self.servo is None or session != self.number:
            raise DeviceError(f"The servo session {session} is over; begin another one.", session=session)
        if self.runs(follower):
            follower.hold(None)
        self.servo = None

    def take(self, setpoint: JointSetpoint, follower: Follower | None) -> None:
        """Goes for a set point of the running session; None for an arm that nobody can tell anything."""
        servo = self.servo
        running = follower is not None and self.runs(follower)
        if servo is not None and running and setpoint.session == self.number and setpoint.number > servo.number:
            servo.take(setpoint)
        else:
            self.dropped += 1

    def check_free(self, follower: Follower, busy: bool) -> None:
        """Accepts a new motion; a session that has ended by itself is forgotten then.

        Raises:
            DeviceError: A session runs, or the arm is `busy` otherwise.
        """
        if self.runs(follower):
            raise DeviceError("A servo session runs; end it or hold the arm before the next motion.")
        if busy:
            raise DeviceError("The arm is still moving; wait for its end or hold it before the next motion.")
        self.servo = None

    def runs(self, follower: Follower) -> bool:
        """Whether the arm follows set points now."""
        return self.servo is not None and follower.reference is self.servo
