"""The simulated arm as a robot driver."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager

from pcmrs.clock import Clock
from pcmrs.devices.motion.sessions import Sessions
from pcmrs.devices.protocols import ServoStream
from pcmrs.devices.servo import servo_session
from pcmrs.devices.stream import Stream
from pcmrs.errors import DeviceError, DeviceRefusedError, UnknownOutcomeError
from pcmrs.messages import (
    DeviceEvent,
    JointSetpoint,
    JointState,
    JointTrajectory,
    MotionResult,
    PressRequest,
    ServoSession,
)
from pcmrs_sim.robot_faults import RobotFaults, hold_if_deviating
from pcmrs_sim.world import World


class SimRobot:
    """Robot that answers as a robot's cabinet does, and not at all while its link is cut.

    It implements `pcmrs.devices.protocols.RobotDriver`.

    Args:
        world: World with the arm.
        clock: Clock that stamps published states.
        start: Time of the first published state, s of `clock`.

    Attributes:
        faults: Present faults.
        sessions: Servo sessions.
        due: Time of the next published state, s of `clock`.
    """

    def __init__(self, world: World, clock: Clock, start: float) -> None:
        self._arm = world.arm
        self._clock = clock
        self._period = 1 / world.settings.arm.state_rate_hz
        self._states: Stream[JointState] = Stream()
        self._events: Stream[DeviceEvent] = Stream()
        self._waiting: list[asyncio.Future[None]] = []
        self._connected = False
        self._last_set_point: JointSetpoint | None = None  # for the fault `late`
        self._drops = 0
        self.faults = RobotFaults()
        self.sessions = Sessions()
        self._time = self.due = start

    @property
    def trouble(self) -> str:
        return "The link of the simulated robot is cut by a fault." if self.faults.cut else ""

    @property
    def dropped(self) -> int:
        return self.sessions.dropped

    async def connect(self) -> JointState:
        self._check_link()
        self._check_not_refusing()
        self._connected = True
        if self.faults.late and self._last_set_point is not None:
            self.sessions.take(self._last_set_point, self._arm)
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
        return await self._motion_result()

    async def press(self, request: PressRequest) -> MotionResult:
        self._check_free()
        press = self._arm.press(request)
        return await self._motion_result(lambda: press.force)

    async def begin_servo(self) -> ServoSession:
        self._check_free()
        if not self.faults.servo_option:
            text = "The controller has no servo option, so the robot follows no set points; nothing was moved."
            raise DeviceError(text, reason="no_servo_option")
        return self.sessions.begin(self._arm)

    async def end_servo(self, session: int) -> MotionResult:
        self._check_connection()
        self.sessions.end(session, self._arm)
        return await self._motion_result()

    def servo(self) -> AbstractAsyncContextManager[ServoStream]:
        return servo_session(self, self.set_point, self._clock)

    def set_point(self, setpoint: JointSetpoint) -> None:
        self._last_set_point = setpoint
        for _ in range(2 if self.faults.doubled else 1):
            self.sessions.take(setpoint, None if self.faults.cut else self._arm)

    async def hold(self) -> JointState:
        self.brake()
        self._check_link()
        await self._wait_for_rest()
        return self._state()

    def states(self) -> AsyncIterator[JointState]:
        return self._states.read()

    def events(self) -> AsyncIterator[DeviceEvent]:
        return self._events.read()

    @property
    def moving(self) -> bool:
        """True while the arm moves."""
        return not self._arm.at_rest

    @property
    def follows(self) -> bool:
        """True while the arm follows a command or a servo session, even if it is at rest at this moment."""
        return not (self._arm.reference.ended or self._arm.stopped)

    def brake(self) -> None:
        """Brake, unless the link is cut."""
        if not self.faults.cut:
            self._arm.hold()

    def lose_node(self, reason: str) -> None:
        """Brake, and raise an alarm, because the node is lost.

        Args:
            reason: Clause that says why the node is considered lost.
        """
        if not self.follows:  # an arm that is already held or at rest needs no alarm
            return
        self._arm.hold("link_silent")
        text = f"The robot brakes by itself: {reason}. Look at the arm before you continue."
        self._arm.alarms.append(DeviceEvent(device="robot", code="link_silent", text=text, danger=True))

    def cut(self, cut: bool) -> None:
        """Cut the link, which ends the connection and makes the arm brake by itself, or restore it."""
        self.faults.cut = cut
        if cut:
            self._lose_connection()

    def update(self, time: float) -> None:
        """End motions when the arm is at rest, and publish alarms and states that are due at a time, s of the clock."""
        self._time = time
        if self.faults.drops > self._drops:
            self._drops = self.faults.drops
            self._fail_application()
        if self._connected:
            hold_if_deviating(self._arm)
        if self._waiting and self._arm.at_rest:
            self._end_waiting(None)
        while self._arm.alarms:
            alarm = self._arm.alarms.popleft()
            if not self._mute:
                self._events.publish(alarm)
        if time >= self.due and not self._mute:
            self._states.publish(self._state())
        while time >= self.due:  # a cell that lags skips states
            self.due += self._period

    def _fail_application(self) -> None:
        """End the connection as a failed application does, and report it."""
        if self._connected:
            self._lose_connection()
            self._events.publish(DeviceEvent(device="robot", code="link_lost", text=_no_answer().text, danger=True))

    def _lose_connection(self) -> None:
        self._connected = False
        self._arm.hold()
        self._end_waiting(_no_answer())

    def close(self) -> None:
        """End all readers, and pending motions with an unknown outcome."""
        self._states.close()
        self._events.close()
        self._end_waiting(_no_answer())

    async def _motion_result(self, force: Callable[[], float] | None = None) -> MotionResult:
        """Wait until the arm is at rest, and return the result of its motion, with the force measured then, N."""
        try:
            await self._wait_for_rest()
        except asyncio.CancelledError:
            self._arm.hold()  # a motion whose caller is gone must not continue
            raise
        return MotionResult(
            outcome="stopped" if self._arm.stopped else "done",
            positions=self._arm.positions.tolist(),
            reason=self._arm.stopped,
            force=force() if force is not None else None,
        )

    async def _wait_for_rest(self) -> None:
        waiting = asyncio.get_running_loop().create_future()
        self._waiting.append(waiting)
        await waiting
        self._check_link()  # the link may have been cut meanwhile

    def _end_waiting(self, error: UnknownOutcomeError | None) -> None:
        for waiting in self._waiting:
            if waiting.done():  # its caller was cancelled
                continue
            if error is None:
                waiting.set_result(None)
            else:
                waiting.set_exception(error)
        self._waiting.clear()

    @property
    def _mute(self) -> bool:
        return self.faults.cut or self.faults.silent

    def _check_link(self) -> None:
        if self._mute:
            raise _no_answer()

    def _check_connection(self) -> None:
        self._check_link()
        if not self._connected:
            raise DeviceError("The robot is not connected; connect it first.")

    def _check_not_refusing(self) -> None:
        if self.faults.refusing:
            raise DeviceRefusedError("The robot refuses. Look at its pendant: mode, brakes, protective stop.")

    def _check_free(self) -> None:
        """Check that a new motion can start."""
        self._check_connection()
        self._check_not_refusing()
        if self.faults.drives_off:
            text = f"The robot's drives are off ({self.faults.drives_off}); release them at the robot before it moves."
            raise DeviceError(text, reason=self.faults.drives_off)
        self.sessions.check_free(self._arm, bool(self._waiting) or not self._arm.reference.ended)

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
            relieving=arm.relieving,
        )


def _no_answer() -> UnknownOutcomeError:
    return UnknownOutcomeError("The robot does not answer. Look at the arm before you continue.")
