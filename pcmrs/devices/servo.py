"""A servo session from the sender's side: opened, given set points, and ended however its block ends."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager, suppress

from pcmrs.clock import Clock
from pcmrs.devices.protocols import Robot, ServoStream
from pcmrs.errors import DeviceError, PcmrsError
from pcmrs.messages import JointSetpoint


class SetpointSender:
    """Numbers the set points of one session; see `ServoStream`.

    Args:
        session: Number of the session.
        put: Sends a set point; never waits.
        clock: Clock for their time stamps.
    """

    def __init__(self, session: int, put: Callable[[JointSetpoint], None], clock: Clock) -> None:
        self._session = session
        self._put = put
        self._clock = clock
        self._number = 0

    def send(self, positions: Iterable[float], velocities: Iterable[float]) -> None:
        self._number += 1
        setpoint = JointSetpoint(
            session=self._session,
            number=self._number,
            sent=self._clock.monotonic(),
            positions=list(map(float, positions)),
            velocities=list(map(float, velocities)),
        )
        self._put(setpoint)


@asynccontextmanager
async def servo_session(robot: Robot, put: Callable[[JointSetpoint], None], clock: Clock) -> AsyncIterator[ServoStream]:
    """Open a session, and end it however the block ends; then the robot stands.

    Args:
        robot: Robot that follows the set points.
        put: Sends a set point to it; never waits.
        clock: Clock for their time stamps.

    Raises:
        DeviceError: The robot refuses, or it had ended the session by itself; field ``reason`` says why.
        UnknownOutcomeError: The robot does not answer.
    """
    session = (await robot.begin_servo()).session
    try:
        yield SetpointSender(session, put, clock)
    except BaseException:
        with suppress(PcmrsError):  # the first error is the cause; a silent robot brakes by its deadman
            await robot.end_servo(session)
        raise
    result = await robot.end_servo(session)
    if result.outcome == "stopped":
        text = f"The robot ended the servo session by itself: {result.reason}. Find the cause before the next one."
        raise DeviceError(text, reason=result.reason)
