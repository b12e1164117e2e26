"""The simulated arm behind the protocol of a robot driver."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager

from pcmrs.clock import Clock
from pcmrs.devices.protocols import ServoStream
from pcmrs.devices.servo import servo_session
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.messages import (
    DeviceEvent,
    JointSetpoint,
    JointState,
    JointTrajectory,
    MotionResult,
    PressRequest,
    ServoSession,
)
from sim.servo import DEADMAN, Servo
from sim.stream import Stream
from sim.world import World


class SimRobot:
    """Answers as a robot's cabinet would, and not at all while its link is cut.

    Args:
        world: Holds the arm.
        clock: Stamps what is sent.
        start: Time of the first published state, s of `clock`.

    Attributes:
        dropped: Set points that were stale or of no running session.
    """

    def __init__(self, world: World, clock: Clock, start: float) -> None:
        self._arm = world.arm
        self._clock = clock
        self._period = 1 / world.settings.arm.state_rate_hz
        self._states: Stream[JointState] = Stream()
        self._events: Stream[DeviceEvent] = Stream()
        self._waiting: list[asyncio.Future[None]] = []
        self._connected = False
        self._cut = False
        self._servo: Servo | None = None
        self._session = 0
        self._time = self.due = start
        self.dropped = 0

    async def connect(self) -> JointState:
        self._check_link()
        self._connected = True
        return self._state()

    async def disconnect(self) -> None:
        self._check_link()
        self._arm.hold()
        self._connected = False

    async def joints(self) -> JointState:
        self._check_connection()
        return self._state()

    async def follow(self, trajectory: JointTrajectory) -> MotionResult:
        self._check_free()
        self._arm.follow(trajectory)
        return await self._end()

    async def press(self, request: PressRequest) -> MotionResult:
        self._check_free()
        press = self._arm.press(request)
        return await self._end(lambda: press.force)

    async def begin_servo(self) -> ServoSession:
        self._check_free()
        self._servo = self._arm.servo()
        self._session += 1
        return ServoSession(session=self._session, deadman=DEADMAN)

    async def end_servo(self, session: int) -> MotionResult:
        self._check_connection()
        if self._servo is None or session != self._session:
            raise DeviceError(f"The servo session {session} is over; begin another one.", session=session)
        servo, self._servo = self._servo, None
        if self._arm.reference is servo:
            self._arm.hold(None)
        return await self._end()

    def servo(self) -> AbstractAsyncContextManager[ServoStream]:
        return servo_session(self, self.set_point, self._clock)

    def set_point(self, setpoint: JointSetpoint) -> None:
        servo = self._servo
        running = servo is not None and self._arm.reference is servo and not self._cut
        if servo is not None and running and setpoint.session == self._session and setpoint.number > servo.number:
            servo.take(setpoint)
        else:
            self.dropped += 1

    async def hold(self) -> JointState:
        self._check_link()
        self._arm.hold()
        await self._rest()
        return self._state()

    def states(self) -> AsyncIterator[JointState]:
        return self._states.read()

    def events(self) -> AsyncIterator[DeviceEvent]:
        return self._events.read()

    def cut(self, cut: bool) -> None:
        """Cuts the link, which ends the connection and makes the arm brake by itself; or restores it."""
        self._cut = cut
        if cut:
            self._connected = False
            self._arm.hold()
            self._end_waiting(_silence())

    def update(self, time: float) -> None:
        """Tells those who wait that the arm rests, and publishes what is due at `time`."""
        self._time = time
        if self._waiting and self._arm.at_rest:
            self._end_waiting(None)
        while self._arm.alarms:
            alarm = self._arm.alarms.popleft()
            if not self._cut:
                self._events.publish(alarm)
        if time >= self.due and not self._cut:
            self._states.publish(self._state())
        while time >= self.due:  # a cell that lags loses states
            self.due += self._period

    def close(self) -> None:
        """Ends all readers, and those who wait without an answer."""
        self._states.close()
        self._events.close()
        self._end_waiting(_silence())

    async def _end(self, force: Callable[[], float] | None = None) -> MotionResult:
        """How the motion ended, once the arm rests; with the `force` measured then."""
        try:
            await self._rest()
        except asyncio.CancelledError:
            self._arm.hold()  # nobody waits for the end any more
            raise
        return MotionResult(
            outcome="stopped" if self._arm.stopped else "done",
            positions=self._arm.positions.tolist(),
            reason=self._arm.stopped,
            force=force() if force is not None else None,
        )

    async def _rest(self) -> None:
        waiting = asyncio.get_running_loop().create_future()
        self._waiting.append(waiting)
        await waiting

    def _end_waiting(self, error: UnknownOutcomeError | None) -> None:
        for waiting in self._waiting:
            if waiting.done():  # its caller was cancelled
                continue
            if error is None:
                waiting.set_result(None)
            else:
                waiting.set_exception(error)
        self._waiting.clear()

    def _check_link(self) -> None:
        if self._cut:
            raise _silence()

    def _check_connection(self) -> None:
        self._check_link()
        if not self._connected:
            raise DeviceError("The robot is not connected; connect it first.")

    def _check_free(self) -> None:
        """Accepts a new motion; a servo session that has ended by itself is forgotten then."""
        self._check_connection()
        if self._servo is not None and self._arm.reference is self._servo:
            raise DeviceError("A servo session runs; end it or hold the arm before the next motion.")
        if self._waiting or not self._arm.reference.ended:
            raise DeviceError("The arm is still moving; wait for its end or hold it before the next motion.")
        self._servo = None

    def _state(self) -> JointState:
        arm = self._arm
        return JointState(
            captured=self._time,
            sent=self._clock.monotonic(),
            positions=arm.positions.tolist(),
            velocities=arm.velocities.tolist(),
            torques=arm.torques.tolist(),
            moving=not arm.at_rest,
            flange_force=arm.sensor.flange_force,
        )


def _silence() -> UnknownOutcomeError:
    return UnknownOutcomeError("The robot does not answer: its link is cut. Look at the arm before going on.")
