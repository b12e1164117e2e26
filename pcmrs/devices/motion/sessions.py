"""Servo sessions of a robot, one after the other: only set points of the running one are followed."""

from __future__ import annotations

from pcmrs.devices.motion._servo import Servo
from pcmrs.devices.motion.follower import Follower
from pcmrs.errors import DeviceError
from pcmrs.messages import JointSetpoint, ServoSession


class Sessions:
    """The sessions of one robot, of which one at most runs.

    Attributes:
        servo: Reference of the session that was not ended by a request yet; it may have ended by itself.
        number: Number of the last session.
        dropped: Number of set points that were stale or of no running session.
    """

    def __init__(self) -> None:
        self.servo: Servo | None = None
        self.number = 0
        self.dropped = 0

    def begin(self, follower: Follower) -> ServoSession:
        """Open a session; the arm must be at rest."""
        self.servo = follower.servo()
        self.number += 1
        return ServoSession(session=self.number, deadman=self.servo.deadman)

    def end(self, session: int, follower: Follower) -> None:
        """End a session, never a later one; the arm brakes unless it has braked already.

        Args:
            session: Number of the session.
            follower: Follower of the arm.

        Raises:
            DeviceError: The session has ended before.
        """
        if self.servo is None or session != self.number:
            raise DeviceError(f"The servo session {session} is over; begin another one.", session=session)
        if self.runs(follower):
            follower.hold(None)
        self.servo = None

    def take(self, setpoint: JointSetpoint, follower: Follower | None) -> None:
        """Follow a set point of the running session; drop any other.

        Args:
            setpoint: The set point.
            follower: Follower of the arm; None if the arm is not connected.
        """
        servo = self.servo
        running = follower is not None and self.runs(follower)
        if servo is not None and running and setpoint.session == self.number and setpoint.number > servo.number:
            servo.take(setpoint)
        else:
            self.dropped += 1

    def check_free(self, follower: Follower, busy: bool) -> None:
        """Check that a new motion may begin, and forget a session that has ended by itself.

        Args:
            follower: Follower of the arm.
            busy: True if another motion runs.

        Raises:
            DeviceError: A session or another motion runs.
        """
        if self.runs(follower):
            raise DeviceError("A servo session runs; end it or hold the arm before the next motion.")
        if busy:
            raise DeviceError("The arm is still moving; wait for its end or hold it before the next motion.")
        self.servo = None

    def runs(self, follower: Follower) -> bool:
        """Return True if the arm follows set points now."""
        return self.servo is not None and follower.reference is self.servo
