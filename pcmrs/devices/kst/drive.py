"""One connected arm: polled while it stands, streamed to while it moves, by one task that alone uses the link."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from itertools import cycle

import numpy as np

from pcmrs.clock import Clock
from pcmrs.devices.kst.arm import MeasuredArm
from pcmrs.devices.kst.cabinet import Cabinet
from pcmrs.devices.kst.settings import KstSettings
from pcmrs.devices.motion.follower import Follower, brake_limits
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.errors import DeviceError, PcmrsError, UnknownOutcomeError
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import DeviceEvent, JointState
from pcmrs.spatial import Floats

POLL_PERIOD = 0.04
"""Between readings of an arm that stands, s."""
STOPPING = 1.0
"""The cabinet may need so much longer than we until its arm rests after a stream, s."""
READINGS_HZ = 100.0
"""Of an arm that moves: half of them its joints, half its torques."""
CATCH_UP = 0.02
"""A stream that is later than this loses time, and the motion takes longer: set points never come in a burst, s."""
LATE = 0.1
"""While a reply is outstanding for longer, the motion waits: the arm is not sent ahead of what it says of itself, s."""
UNSETTLED = 5.0
"""An arm that does not stand still so long after its reference ended is pushed, or oscillates, s."""
STALLED = 0.3
"""A stream that has paused for so long ends where it is, s."""

Waiting = list[asyncio.Future[None]]


class Drive:
    """What the arm follows, and how the cabinet is told.

    Args:
        cabinet: Just connected.
        posture: Its measured joints, where the reference starts, rad, (n,).
        settings: How to stream.
        model: The arm.
        force: When the force on the tool is too great.
        clock: Paces the stream.
        publish: Takes every new state.
        report: Takes what the arm has to report.

    Attributes:
        arm: As it was measured.
        follower: What it follows.
    """

    def __init__(
        self,
        cabinet: Cabinet,
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
        self._asks = cycle(
            ((cabinet.stream_for_joints, self._take_joints), (cabinet.stream_for_torques, self.arm.take_torques))
        )
        self._reply: asyncio.Future[str] | None = None
        self._take: Callable[[Floats], None] = self._take_joints
        self._asked = 0.0
        self._ended = np.inf
        self._wake = asyncio.Event()
        self._resting: Waiting = []
        self._started: Waiting = []
        self._streaming = self._refusing = self._deviated = False

    async def run(self) -> None:
        """Polls and streams until the link fails, which is the outcome of all that then waits.

        Raises:
            UnknownOutcomeError: It has failed.
        """
        patience = 0.0
        try:
            while True:
                await self._attempt(self._poll(patience))
                self.follower.supervise()  # somebody may push an arm that stands, too
                if self.follower.reference.ended:
                    self._release()
                    patience = 0.0
                    await self._pause()
                else:
                    patience = STOPPING
                    self._streaming = True
                    await self._attempt(self._stream())
                    self._streaming = False
        except UnknownOutcomeError as error:
            self._release(error)
            raise
        finally:
            self._release(UnknownOutcomeError("The connection ended before the arm was seen at rest. Look at the arm."))

    @property
    def moving(self) -> bool:
        """Whether the arm moves, or a session goes on."""
        return self._streaming or not self.follower.reference.ended

    @property
    def busy(self) -> bool:
        """Whether the last motion has yet to be reported."""
        return self.moving or bool(self._resting)

    @property
    def state(self) -> JointState:
        """The newest readings."""
        return self.arm.state(self._clock.monotonic(), moving=self.moving, relieving=self.follower.relieving)

    async def started(self) -> None:
        """Returns when the cabinet follows the stream; raises as `rest`."""
        await self._wait(self._started)

    async def rest(self) -> None:
        """Returns when the arm stands and the stream has ended.

        Raises:
            DeviceError: The cabinet refused or interrupted the motion.
            UnknownOutcomeError: The link has failed.
        """
        await self._wait(self._resting)

    async def end(self) -> None:
        """Ends the KST application and the link, when `run` has ended."""
        try:
            await self._cabinet.drain()
        finally:
            self._cabinet.end()

    async def _wait(self, waiting: Waiting) -> None:
        future: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        waiting.append(future)
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
        """Gives up what the cabinet refuses or interrupts; the link goes on, so that it can be asked again."""
        try:
            await part
        except DeviceError as error:
            await self._cabinet.drain()
            self.follower.stand(self.arm.positions.copy(), error.code)
            self._release(error)
            if not self._refusing:
                self._report(DeviceEvent(device="robot", code=error.code, text=error.text, danger=True))
            self._refusing = True
        else:
            self._refusing = False

    async def _poll(self, patience: float) -> None:
        asked = self._clock.monotonic()
        self.arm.take_joints(await self._cabinet.joints(), asked)
        self.arm.take_torques(await self._cabinet.external_torques(patience))
        self._publish(self.state)

    async def _stream(self) -> None:
        cabinet, impedance = self._cabinet, self._settings.mode == "impedance"
        self.arm.begin()
        self._reply, self._ended, self._deviated = None, np.inf, False
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
            self._hear()
            ticked = self._stand_if_stalled(ticked)
            self._check_settles()
            if not self._waits():
                self._send(ask=number % every == 0)
                number += 1
            due = await self._until(due + self._step)

    def _waits(self) -> bool:
        """Whether the cabinet is late; who brakes does not wait for it."""
        late = self._reply is not None and self._clock.monotonic() - self._asked > LATE
        return late and self.follower.stopped is None

    def _check_settles(self) -> None:
        if self._clock.monotonic() - self._ended > UNSETTLED:
            text = f"The arm does not stand still within {UNSETTLED:g} s of its motion's end: look what moves it."
            raise DeviceError(text, limit=UNSETTLED)

    def _stand_if_stalled(self, ticked: float) -> float:
        """Leaves the arm where it is when this process was held up since `ticked`; returns the present time, s.

        It has stopped long ago: to brake from the speed that it had then would move it once more.
        """
        now = self._clock.monotonic()
        if now - ticked > STALLED:
            self.follower.stand(self.follower.reference.position.copy(), "stalled")
            self._alarm("stalled", f"stands: its stream was held up for {now - ticked:.2f} s")
        return now

    async def _until(self, due: float) -> float:
        """Waits for the next moment of the stream, and returns it; it is another one when that has long passed."""
        now = self._clock.monotonic()
        if now - due > CATCH_UP:
            due = now
        await self._clock.sleep(due - now)
        return due

    def _send(self, ask: bool) -> None:
        target = self.follower.advance()[0].copy()
        while self.follower.alarms:
            self._report(self.follower.alarms.popleft())
        now = self._clock.monotonic()
        self.arm.told(target, now)
        if ask and self._reply is None:
            stream, self._take = next(self._asks)
            self._asked = now
            self._reply = stream(target)
        else:
            self._cabinet.stream(target)

    def _hear(self) -> None:
        """Takes the reply that has come, if one has."""
        if self._reply is not None and self._reply.done():
            reply, self._reply = self._reply, None
            self._take(self._cabinet.values(reply.result()))

    def _take_joints(self, positions: Floats) -> None:
        self.arm.take_joints(positions, self._asked)
        deviation, limit = self.arm.deviation, self._settings.pose_limit
        if deviation > limit and not self._deviated:
            self._deviated = True
            self.follower.hold("pose_differs")
            far = f"a joint is {deviation:.3f} rad from where it was told to be, limit {limit:g}"
            self._alarm("pose_differs", f"brakes: {far}")
        self._publish(self.state)

    def _alarm(self, code: str, text: str) -> None:
        text = f"The robot {text}. Look at the arm before going on."
        self._report(DeviceEvent(device="robot", code=code, text=text, danger=True))

    def _at_rest(self) -> bool:
        reference = self.follower.reference
        if not reference.ended:
            self._ended = np.inf
        elif self._ended == np.inf:
            self._ended = self._clock.monotonic()
        return self.arm.at_rest(reference.position, self._ended)

    def _release(self, error: PcmrsError | None = None) -> None:
        _release(self._started, error)
        _release(self._resting, error)


def _release(waiting: Waiting, error: PcmrsError | None = None) -> None:
    for future in waiting:
        if future.done():  # its caller was cancelled
            continue
        if error is None:
            future.set_result(None)
        else:
            future.set_exception(type(error)(error.text, **error.fields))
    waiting.clear()
