"""The simulated arm behind the protocol of a robot driver."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

from pcmrs.clock import Clock
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.messages import JointState, JointTrajectory, MotionResult
from sim.stream import Stream
from sim.world import World


class SimRobot:
    """Answers as a robot's cabinet would, and not at all while its link is cut.

    Args:
        world: Holds the arm.
        clock: Stamps what is sent.
        start: Time of the first published state, s of `clock`.
    """

    def __init__(self, world: World, clock: Clock, start: float) -> None:
        self._arm = world.arm
        self._clock = clock
        self._period = 1 / world.settings.arm.state_rate_hz
        self._stream: Stream[JointState] = Stream()
        self._waiting: list[asyncio.Future[None]] = []
        self._connected = False
        self._cut = False
        self._stopped = False
        self._time = self.due = start

    async def connect(self) -> JointState:
        self._check_link()
        self._connected = True
        return self._state()

    async def disconnect(self) -> None:
        self._check_link()
        self._brake()
        self._connected = False

    async def joints(self) -> JointState:
        self._check_connection()
        return self._state()

    async def follow(self, trajectory: JointTrajectory) -> MotionResult:
        self._check_connection()
        if self._waiting or not self._arm.reference.ended:
            raise DeviceError("The arm is still moving; wait for its end or hold it before the next motion.")
        self._arm.follow(trajectory)
        self._stopped = False
        try:
            await self._rest()
        except asyncio.CancelledError:
            self._brake()  # nobody waits for the end any more
            raise
        positions = self._arm.positions.tolist()
        if self._stopped:
            return MotionResult(outcome="stopped", positions=positions, reason="held")
        return MotionResult(outcome="done", positions=positions)

    async def hold(self) -> JointState:
        self._check_link()
        self._brake()
        await self._rest()
        return self._state()

    def states(self) -> AsyncIterator[JointState]:
        return self._stream.read()

    def cut(self, cut: bool) -> None:
        """Cuts the link, which ends the connection and makes the arm brake by itself; or restores it."""
        self._cut = cut
        if cut:
            self._connected = False
            self._brake()
            self._end_waiting(_silence())

    def update(self, time: float) -> None:
        """Tells those who wait that the arm rests, and publishes the state that is due at `time`."""
        self._time = time
        if self._waiting and self._arm.at_rest:
            self._end_waiting(None)
        if time >= self.due and not self._cut:
            self._stream.publish(self._state())
        while time >= self.due:  # a cell that lags loses states
            self.due += self._period

    def close(self) -> None:
        """Ends all readers, and those who wait without an answer."""
        self._stream.close()
        self._end_waiting(_silence())

    def _brake(self) -> None:
        if not self._arm.reference.ended:
            self._stopped = True
            self._arm.hold()

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

    def _state(self) -> JointState:
        arm = self._arm
        return JointState(
            captured=self._time,
            sent=self._clock.monotonic(),
            positions=arm.positions.tolist(),
            velocities=arm.velocities.tolist(),
            torques=arm.torques.tolist(),
            moving=not arm.at_rest,
        )


def _silence() -> UnknownOutcomeError:
    return UnknownOutcomeError("The robot does not answer: its link is cut. Look at the arm before going on.")
