"""One connected arm: polled at rest and streamed to in motion, by one task that alone uses the link."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from itertools import cycle

import numpy as np

from pcmrs.clock import Clock
from pcmrs.devices.kst._arm import SETTLING, MeasuredArm
from pcmrs.devices.kst.connection import KstConnection
from pcmrs.devices.kst.settings import KstSettings
from pcmrs.devices.motion.follower import Follower, brake_limits
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.errors import DeviceError, PcmrsError, UnknownOutcomeError
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import DeviceEvent, JointState
from pcmrs.spatial import Floats

POLL_PERIOD = 0.04
"""Time between two readings of an arm at rest, s."""
STOPPING = 1.0
"""Additional time that the cabinet may need until its arm rests after a stream, s."""
READINGS_HZ = 100.0
"""Rate of readings of a moving arm, 1/s: half of them joints, half torques."""
CATCH_UP = 0.02
"""Delay of the stream beyond which the motion takes longer, s: set points are never sent in a burst."""
LATE = 0.1
"""Delay of a reply beyond which the motion waits, s: the arm is not moved ahead of its readings."""
UNSETTLED = 5.0
"""Time after the end of its reference after which an arm that still moves is pushed or oscillates, s."""
STALLED = 0.3
"""Pause of the stream after which the motion ends where the arm is, s."""

Waiting = list[tuple[float, asyncio.Future[None]]]
"""Callers that wait: the time at which each has asked, s of the clock, and its future."""


class Drive:
    """Motion along a reference that streams its set points to the cabinet.

    Args:
        cabinet: Connection to the cabinet, just opened.
        posture: Measured joints, at which the reference starts, rad, (n,).
        settings: Settings of the stream.
        model: Model of the arm.
        force: Limits of the force on the tool.
        clock: Clock that paces the stream.
        publish: Called with each new state.
        report: Called with each event that the arm reports.

    Attributes:
        settling: As for `MeasuredArm.at_rest`.
        arm: Readings of the arm.
        follower: Reference of the arm.
    """

    settling = SETTLING

    def __init__(
        self,
        cabinet: KstConnection,
        posture: Floats,
        settings: KstSettings,
        model: ArmModel,
        force: ForceSettings,
        clock: Clock,
        publish: Callable[[JointState], None],
        report: Callable[[DeviceEvent], None],
    ) -> None:
        self._cabinet, self._settings = cabinet, settings
        self._clock, self._publish, self._report = clock, publish, report
        self._step = 1 / settings.rate_hz
        self.arm = MeasuredArm(model, np.array(settings.tool_axis), self._step)
        self.arm.take_joints(posture, clock.monotonic())
        limits = brake_limits(model.facts, settings.brake_acceleration, settings.brake_jerk)
        self.follower = Follower(model, limits, force, self.arm.force, posture, self._step)
        self._requests = cycle(
            ((cabinet.stream_for_joints, self._take_joints), (cabinet.stream_for_torques, self.arm.take_torques))
        )
        self._reply: asyncio.Future[str] | None = None
        self._take: Callable[[Floats], None] = self._take_joints
        self._requested_at = 0.0
        self._ended_at = np.inf
        self._wake = asyncio.Event()
        self._resting: Waiting = []
        self._started: Waiting = []
        self._reading: Waiting = []
        self._polled_at = -np.inf
        self._streaming = self._refusing = self._deviated = False

    async def run(self) -> None:
        """Poll and stream until the link fails; pending calls then fail, too.

        Raises:
            UnknownOutcomeError: The link has failed.
        """
        patience = 0.0
        try:
            while True:
                await self._attempt(self._poll(patience))
                self.follower.supervise()  # a force on an arm at rest must be relieved, too
                self._report_alarms()
                if self.follower.reference.ended:
                    _release(self._started)
                    _release(self._resting, until=self._polled_at)
                    patience = 0.0
                    await self._pause()
                else:
                    patience = STOPPING
                    self._streaming = True
                    await self._attempt(self._move())
                    self._streaming = False
        except UnknownOutcomeError as error:
            self._fail(error)
            raise
        finally:
            self._fail(UnknownOutcomeError("The connection ended before the arm was seen at rest. Look at the arm."))

    @property
    def moving(self) -> bool:
        """True if the arm moves, or a servo session runs."""
        return self._streaming or not self.follower.reference.ended

    @property
    def busy(self) -> bool:
        """True if the last motion has yet to be reported."""
        return self.moving or bool(self._resting)

    @property
    def state(self) -> JointState:
        """Newest readings as a message."""
        return self.arm.state(self._clock.monotonic(), moving=self.moving, relieving=self.follower.relieving)

    async def started(self) -> None:
        """Wait until the cabinet follows the stream; see `rest` for the errors."""
        await self._wait(self._started)

    async def reading(self) -> None:
        """Wait for joints that are requested after this call, moving or not; see `rest` for the errors."""
        await self._wait(self._reading)

    async def rest(self) -> None:
        """Wait until the arm stands and the stream has ended, by joints that are requested after this call.

        Raises:
            DeviceError: The cabinet refused or interrupted the motion.
            UnknownOutcomeError: The link has failed.
        """
        await self._wait(self._resting)

    async def end(self) -> None:
        """End the KST application and the link, when `run` has ended."""
        try:
            await self._cabinet.drain()
        finally:
            self._cabinet.end()

    async def _wait(self, waiting: Waiting) -> None:
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        waiting.append((self._clock.monotonic(), future))
        self._wake.set()
        await future

    async def _pause(self) -> None:
        try:
            async with self._clock.timeout(POLL_PERIOD):
                await self._wake.wait()
        except TimeoutError:
            return
        self._wake.clear()

    async def _attempt(self, part: Awaitable[None]) -> None:
        """Run a part, and give it up if the cabinet refuses or interrupts it; the link stays open for another try."""
        try:
            await part
        except DeviceError as error:
            await self._cabinet.drain()
            self.follower.stand(self.arm.positions.copy(), error.code)
            self._fail(error)
            if not self._refusing:
                self._report(DeviceEvent(device="robot", code=error.code, text=error.text, danger=True))
            self._refusing = True
        else:
            self._refusing = False

    async def _poll(self, patience: float) -> None:
        self._polled_at = self._clock.monotonic()
        self._take_reading(await self._cabinet.joints(), self._polled_at)
        self.arm.take_torques(await self._cabinet.external_torques(patience))
        self._publish(self.state)

    async def _move(self) -> None:
        """Follow the reference to its end, and return when the arm is at rest."""
        cabinet, impedance = self._cabinet, self._settings.mode == "impedance"
        self.arm.begin()
        self._reply, self._ended_at, self._deviated = None, np.inf, False
        await (
            cabinet.start_impedance(self._settings.impedance, self.arm.positions)
            if impedance
            else cabinet.start_servo()
        )
        _release(self._started)
        await self._tick_until_rest()
        await (cabinet.stop_impedance() if impedance else cabinet.stop_servo())

    async def _tick_until_rest(self) -> None:
        due, number = self._clock.monotonic(), 0
        ticked = due
        every = max(1, round(self._settings.rate_hz / READINGS_HZ))
        while not self._at_rest() or self._reply is not None:
            self._cabinet.check()
            self._take_reply()
            ticked = self._stand_if_stalled(ticked)
            self._check_settles()
            if not self._must_wait():
                self._send(ask=number % every == 0)
                number += 1
            due = await self._until(due + self._step)

    def _must_wait(self) -> bool:
        """Return True if a reply of the cabinet is late; a braking arm does not wait for it."""
        late = self._reply is not None and self._clock.monotonic() - self._requested_at > LATE
        return late and self.follower.stopped is None

    def _check_settles(self) -> None:
        if self._clock.monotonic() - self._ended_at > UNSETTLED:
            text = f"The arm does not stand still within {UNSETTLED:g} s of its motion's end: find out what moves it."
            raise DeviceError(text, limit=UNSETTLED)

    def _stand_if_stalled(self, ticked: float) -> float:
        """Leave the arm where it is if this process was held up since `ticked`; return the present time, s.

        The arm stopped long ago: braking from its speed at that time would move it again.
        """
        now = self._clock.monotonic()
        if now - ticked > STALLED:
            self.follower.stand(self.follower.reference.position.copy(), "stalled")
            self._alarm("stalled", f"stands: its stream was held up for {now - ticked:.2f} s")
        return now

    async def _until(self, due: float) -> float:
        """Wait for the next set point's time `due`, and return it; if it is more than `CATCH_UP` ago, return now."""
        now = self._clock.monotonic()
        if now - due > CATCH_UP:
            due = now
        await self._clock.sleep(due - now)
        return due

    def _send(self, ask: bool) -> None:
        target = self.follower.advance()[0].copy()
        self._report_alarms()
        now = self._clock.monotonic()
        self.arm.add_set_point(target, now)
        if ask and self._reply is None:
            stream, self._take = next(self._requests)
            self._requested_at = now
            self._reply = stream(target)
        else:
            self._cabinet.stream(target)

    def _report_alarms(self) -> None:
        while self.follower.alarms:
            self._report(self.follower.alarms.popleft())

    def _take_reply(self) -> None:
        """Take the outstanding reply if it has arrived."""
        if self._reply is not None and self._reply.done():
            reply, self._reply = self._reply, None
            self._take(self._cabinet.values(reply.result()))

    def _take_reading(self, positions: Floats, requested_at: float) -> None:
        self.arm.take_joints(positions, requested_at)
        _release(self._reading, until=requested_at)

    def _take_joints(self, positions: Floats) -> None:
        self._take_reading(positions, self._requested_at)
        deviation, limit = self.arm.deviation, self._settings.pose_limit
        if deviation > limit and not self._deviated:
            self._deviated = True
            self.follower.hold("pose_differs")
            cause = f"a joint is {deviation:.3f} rad from its set points, limit {limit:g} rad"
            self._alarm("pose_differs", f"brakes: {cause}")
        self._publish(self.state)

    def _alarm(self, code: str, text: str) -> None:
        text = f"The robot {text}. Look at the arm before you continue."
        self._report(DeviceEvent(device="robot", code=code, text=text, danger=True))

    def _at_rest(self) -> bool:
        reference = self.follower.reference
        if not reference.ended:
            self._ended_at = np.inf
        elif self._ended_at == np.inf:
            self._ended_at = self._clock.monotonic()
        return self.arm.at_rest(reference.position, self._ended_at, self.settling)

    def _fail(self, error: PcmrsError) -> None:
        for waiting in (self._started, self._resting, self._reading):
            _release(waiting, error)


def _release(waiting: Waiting, error: PcmrsError | None = None, *, until: float = np.inf) -> None:
    """Answer the callers that asked no later than `until`; the others wait for a newer measurement.

    Args:
        waiting: Waiting callers; the answered ones are removed.
        error: Error for them; None if they waited successfully.
        until: Time up to which callers are answered, s of the clock.
    """
    answered = [future for asked, future in waiting if asked <= until]
    waiting[:] = [each for each in waiting if each[0] > until]
    for future in answered:
        if future.done():  # its caller was cancelled
            continue
        if error is None:
            future.set_result(None)
        else:
            future.set_exception(type(error)(error.text, **error.fields))
