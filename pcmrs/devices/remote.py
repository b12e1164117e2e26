"""Devices on the other side of the bus, behind the same protocols as the devices themselves."""

from __future__ import annotations

from contextlib import AbstractAsyncContextManager
from typing import Any, TypeVar

import msgspec

from pcmrs.clock import Clock
from pcmrs.devices.link import Link
from pcmrs.devices.protocols import ServoStream
from pcmrs.devices.servo import servo_session
from pcmrs.errors import DeviceError, UnknownOutcomeError
from pcmrs.messages import (
    DeviceReply,
    DeviceRequest,
    Epoch,
    FiredPulse,
    HeadMotion,
    JointSetpoint,
    JointState,
    JointTrajectory,
    LandmarkPrompt,
    MotionResult,
    PressRequest,
    SceneTruth,
    ServoSession,
    StimulatorState,
)

T = TypeVar("T")

ANSWER_TIME = 2.0
"""A device that is not moving answers within this, s."""

CONNECTING_TIME = 15.0
"""A robot that is not there is known not to be within this, s: longer than any driver waits for one."""

CHARGING_TIME = 10.0
"""A stimulator is charged within this, s."""

MOTION_MARGIN = 3.0
"""A motion may take so much longer than its trajectory, s."""


class RemoteDevice:
    """Calls methods of one device through its node.

    Args:
        link: The bus.
        device: Name of the device, such as ``robot``.
        clock: The machine's clock, by which calls time out.
    """

    def __init__(self, link: Link, device: str, clock: Clock) -> None:
        self._link = link
        self._device = device
        self._clock = clock

    async def call(self, method: str, kind: type[T], timeout: float = ANSWER_TIME, **arguments: Any) -> T:
        """Calls a method and returns its result as `kind`.

        Raises:
            DeviceError: The device answered with a failure; field ``code`` holds its code.
            UnknownOutcomeError: No answer came, or one that is no `kind`.
        """
        request = DeviceRequest(method=method, arguments=msgspec.to_builtins(arguments), sent=self._clock.monotonic())
        what = f"{self._device}.{method}"
        try:
            async with self._clock.timeout(timeout):
                reply = await self._link.request(f"dev/{self._device}/cmd", request, DeviceReply, timeout)
        except TimeoutError:
            raise UnknownOutcomeError(f"{what} was not answered within {timeout:g} s.", method=what) from None
        if reply.failure is not None:
            failure = reply.failure
            if failure.code == UnknownOutcomeError.code:
                raise UnknownOutcomeError(failure.text, **failure.fields)
            raise DeviceError(failure.text, **(failure.fields | {"code": failure.code}))
        try:
            return msgspec.convert(reply.result, kind)
        except msgspec.ValidationError as error:
            raise UnknownOutcomeError(f"{what} answered with something unexpected: {error}.", method=what) from error


class RemoteRobot(RemoteDevice):
    """A robot behind its node; see `Robot`."""

    def __init__(self, link: Link, clock: Clock) -> None:
        super().__init__(link, "robot", clock)

    async def connect(self) -> JointState:
        return await self.call("connect", JointState, CONNECTING_TIME)

    async def disconnect(self) -> None:
        await self.call("disconnect", type(None))

    async def joints(self) -> JointState:
        return await self.call("joints", JointState)

    async def follow(self, trajectory: JointTrajectory) -> MotionResult:
        duration = trajectory.period * len(trajectory.positions)
        return await self.call("follow", MotionResult, duration + MOTION_MARGIN, trajectory=trajectory)

    async def press(self, request: PressRequest) -> MotionResult:
        return await self.call("press", MotionResult, request.timeout + MOTION_MARGIN, request=request)

    async def begin_servo(self) -> ServoSession:
        return await self.call("begin_servo", ServoSession)

    async def end_servo(self, session: int) -> MotionResult:
        return await self.call("end_servo", MotionResult, session=session)

    def servo(self) -> AbstractAsyncContextManager[ServoStream]:
        return servo_session(self, self._put, self._clock)

    async def hold(self) -> JointState:
        return await self.call("hold", JointState)

    def _put(self, setpoint: JointSetpoint) -> None:
        self._link.publish("dev/robot/setpoint", setpoint)


class RemotePointer(RemoteDevice):
    """A pointer behind its node; see `Pointer`."""

    def __init__(self, link: Link, clock: Clock, touch_timeout: float) -> None:
        super().__init__(link, "pointer", clock)
        self._touch_timeout = touch_timeout

    async def touch(self, prompt: LandmarkPrompt) -> None:
        await self.call("touch", type(None), self._touch_timeout, prompt=prompt)

    async def touch_surface(self) -> None:
        await self.call("touch_surface", type(None), self._touch_timeout)

    async def release(self) -> None:
        await self.call("release", type(None))


class RemoteStimulator(RemoteDevice):
    """A stimulator behind its node; see `Stimulator`."""

    def __init__(self, link: Link, clock: Clock) -> None:
        super().__init__(link, "stimulator", clock)

    async def state(self) -> StimulatorState:
        return await self.call("state", StimulatorState)

    async def set_intensity(self, percent: float) -> StimulatorState:
        return await self.call("set_intensity", StimulatorState, percent=percent)

    async def arm(self) -> StimulatorState:
        return await self.call("arm", StimulatorState, CHARGING_TIME)

    async def disarm(self) -> StimulatorState:
        return await self.call("disarm", StimulatorState)

    async def fire(self, number: int) -> FiredPulse:
        return await self.call("fire", FiredPulse, number=number)


class RemoteEmg(RemoteDevice):
    """An electromyograph behind its node; see `Emg`."""

    def __init__(self, link: Link, clock: Clock) -> None:
        super().__init__(link, "emg", clock)

    async def epoch(self, pulse: int, before: float, after: float) -> Epoch:
        return await self.call("epoch", Epoch, after + ANSWER_TIME, pulse=pulse, before=before, after=after)


class RemoteScene(RemoteDevice):
    """A simulated scene behind its node; see `Scene`."""

    def __init__(self, link: Link, clock: Clock) -> None:
        super().__init__(link, "scene", clock)

    async def truth(self) -> SceneTruth:
        return await self.call("truth", SceneTruth)

    async def reseed(self, seed: int) -> None:
        await self.call("reseed", type(None), seed=seed)

    async def displace_touch(self, index: int, offset_in_image: tuple[float, float, float]) -> None:
        await self.call("displace_touch", type(None), index=index, offset_in_image=offset_in_image)

    async def occlude(self, body: str, hidden: bool) -> None:
        await self.call("occlude", type(None), body=body, hidden=hidden)

    async def move_body(self, offset_in_tracker: tuple[float, float, float]) -> None:
        await self.call("move_body", type(None), offset_in_tracker=offset_in_tracker)

    async def set_motion(self, motion: HeadMotion) -> None:
        await self.call("set_motion", type(None), motion=motion)

    async def bump_reference(
        self, offset_in_body_ref: tuple[float, float, float], rotvec: tuple[float, float, float]
    ) -> None:
        await self.call("bump_reference", type(None), offset_in_body_ref=offset_in_body_ref, rotvec=rotvec)

    async def pivot_pointer(self, duration: float) -> None:
        await self.call("pivot_pointer", type(None), duration=duration)

    async def cut_robot(self, cut: bool) -> None:
        await self.call("cut_robot", type(None), cut=cut)

    async def inject(self, fault: str, arguments: dict[str, Any]) -> None:
        await self.call("inject", type(None), fault=fault, arguments=arguments)
