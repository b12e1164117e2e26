"""Proxies of devices on the other side of the bus, with the same protocols as the devices themselves."""

from __future__ import annotations

import uuid
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, suppress
from typing import Any, TypeVar

import msgspec

from pcmrs.clock import Clock
from pcmrs.devices.gate import HOLD_TIME, HOLDS, RELEASE
from pcmrs.devices.link import Link
from pcmrs.devices.protocols import ServoStream
from pcmrs.devices.servo import servo_session
from pcmrs.errors import DeviceError, PcmrsError, UnknownOutcomeError
from pcmrs.messages import (
    ActToken,
    DeviceReply,
    DeviceRequest,
    Epoch,
    FiredPulse,
    GateState,
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
"""Time within which a device answers a request that moves nothing, s."""

CONNECTING_TIME = 15.0
"""Time within which a connection to a robot is made or has failed, s: longer than any driver waits for one."""

DISCONNECTING_TIME = 5.0
"""Limit for `disconnect`, s: a driver waits up to 2 s for an arm that brakes."""

CHARGING_TIME = 10.0
"""Time within which a stimulator is charged, s."""

REPORTS_TO_RETURN = 3
"""Number of successive reports after which a node session that counted as replaced is the present one again.

What seemed to be the report of its successor was then a late report of its predecessor.
"""

MOTION_MARGIN = 3.0
"""Time that a motion may take beyond the duration of its trajectory, s."""


class RemoteDevice:
    """Client that calls methods of one device through its node.

    Args:
        link: Bus.
        device: Name of the device, such as ``robot``.
        clock: Clock of the machine, for timeouts and time stamps.
    """

    def __init__(self, link: Link, device: str, clock: Clock) -> None:
        self._link = link
        self._device = device
        self._clock = clock

    async def call(self, method: str, kind: type[T], timeout: float = ANSWER_TIME, **arguments: Any) -> T:
        """Call a method and return its result.

        Args:
            method: Name of the method.
            kind: Type of the result.
            timeout: Longest wait for the answer, s of the machine.
            **arguments: Arguments of the method.

        Raises:
            DeviceError: The device answered with a failure; field ``code`` holds its code.
            UnknownOutcomeError: No answer came, or one that is not of type `kind`.
        """
        return await self._send(self._request(method, arguments), kind, timeout)

    def _request(self, method: str, arguments: dict[str, Any]) -> DeviceRequest:
        return DeviceRequest(method=method, arguments=msgspec.to_builtins(arguments), sent=self._clock.monotonic())

    async def _send(
        self, request: DeviceRequest, kind: type[T], timeout: float, sender: str = "", *, urgent: bool = False
    ) -> T:
        name, on_reply = f"{self._device}.{request.method}", self._reply_listener()
        try:
            async with self._clock.timeout(timeout):
                key = f"dev/{self._device}/cmd"
                reply = await self._link.request(key, request, DeviceReply, timeout, sender, urgent=urgent)
        except TimeoutError:
            raise UnknownOutcomeError(f"{name} was not answered within {timeout:g} s.", method=name) from None
        on_reply(reply)
        if reply.failure is not None:
            failure = reply.failure
            if failure.code == UnknownOutcomeError.code:
                raise UnknownOutcomeError(failure.text, **failure.fields)
            raise DeviceError(failure.text, **({"code": failure.code} | failure.fields))
        try:
            return msgspec.convert(reply.result, kind)
        except msgspec.ValidationError as error:
            raise UnknownOutcomeError(f"The answer of {name} has the wrong type: {error}.", method=name) from error

    def _reply_listener(self) -> Callable[[DeviceReply], None]:
        """Return the function that takes the gate state in the reply to a request that is sent now."""
        return _ignore_gate


def _ignore_gate(_: DeviceReply) -> None:
    """Ignore the gate state of a device that has no gate."""


class ActingDevice(RemoteDevice):
    """Proxy of an acting device: its requests carry the token that `pcmrs.devices.gate` requires.

    Acting requests are sent in the order in which they are made; a hold never waits behind one of them.

    Args:
        link: Bus.
        device: Name of a device in `gate.ACTS`.
        clock: Clock of the machine, for timeouts and time stamps.
        daemon: Daemon session; by default a new one.

    Attributes:
        name: Name of the device.
        gate: Newest reported state of its gate; None until there is a report.
        unreleased: Node session and epoch for which a release has failed: the device is known to be latched.
    """

    def __init__(self, link: Link, device: str, clock: Clock, daemon: str | None = None) -> None:
        super().__init__(link, device, clock)
        self.name = device
        self.gate: GateState | None = None
        self.unreleased: tuple[str, int] | None = None
        self._daemon = daemon or uuid.uuid4().hex
        self._replaced: dict[str, int] = {}
        self._number = 0

    @property
    def foreign(self) -> bool:
        """True if the device acts for an earlier daemon."""
        return self.gate is not None and self.gate.daemon not in ("", self._daemon)

    @property
    def latched(self) -> bool:
        """True if the device is latched by its newest report, and until there is one."""
        return self.gate is None or self.gate.latched

    def take(self, gate: GateState | None) -> None:
        """Take the gate state from a heartbeat or reply of the device's node if it is newer than the last one."""
        known = self.gate
        if gate is None:
            return
        if known is not None and known.node == gate.node:
            self._replaced = dict.fromkeys(self._replaced, 0)
            if gate.changes > known.changes:
                self.gate = gate
            return
        if gate.node in self._replaced:
            self._replaced[gate.node] += 1
            if self._replaced[gate.node] < REPORTS_TO_RETURN:
                return
            del self._replaced[gate.node]
        if known is not None:
            self._replaced[known.node] = 0
        self.gate = gate

    async def act(self, method: str, kind: type[T], timeout: float = ANSWER_TIME, **arguments: Any) -> T:
        """Call an acting method, for the sessions and the hold epoch that are known now.

        Args:
            method: Name of the method.
            kind: Type of the result.
            timeout: Longest wait for the answer, s of the machine.
            **arguments: Arguments of the method.

        Raises:
            DeviceError: See `call`. The device is latched, or was held or restarted meanwhile: nothing has happened.
            UnknownOutcomeError: No answer came, or one that is not of type `kind`.
        """
        if self.gate is None:
            raise DeviceError(f"The node of the {self._device} has not reported yet: wait for it, then ask again.")
        request = msgspec.structs.replace(self._request(method, arguments), token=self.token())
        return await self._send(request, kind, timeout, self._device)

    async def end(self, kind: type[T], *, latch: bool = False) -> T:
        """End whatever acts, for any session and epoch, and return the result of the hold.

        Args:
            kind: Type of the result.
            latch: True to latch the device, too.

        Raises:
            DeviceError: See `call`.
            UnknownOutcomeError: The device did not confirm that in time.
        """
        request = msgspec.structs.replace(self._request(HOLDS[self._device], {}), token=self.token(), latch=latch)
        return await self._send(request, kind, HOLD_TIME, f"{self._device} hold", urgent=True)

    async def release_latch(self) -> None:
        """Release the device for this daemon, unless it was held again or restarted since its last report.

        Raises:
            DeviceError: The device was held again or restarted, or there is no report yet.
            UnknownOutcomeError: The device does not answer.
        """
        if self.gate is None:
            raise DeviceError(f"The node of the {self._device} has not reported yet: wait for it, then ask again.")
        self.unreleased = (self.gate.node, self.gate.epoch)
        request = msgspec.structs.replace(self._request(RELEASE, {}), token=self.token())
        await self._send(request, type(None), HOLD_TIME, self._device)
        self.unreleased = None

    async def take_over(self) -> None:
        """End whatever an earlier daemon has started; a failure is ignored and leaves the device as it is."""
        with suppress(PcmrsError):
            await self.end(object, latch=True)

    def token(self) -> ActToken:
        """Return the token of the next request. Before the first report of a node, no device acts for it."""
        self._number += 1
        node, epoch = (self.gate.node, self.gate.epoch) if self.gate is not None else ("", -1)
        return ActToken(daemon=self._daemon, node=node, epoch=epoch, number=self._number)

    @property
    def _node(self) -> str:
        """Session of the known node; empty before its first report."""
        return "" if self.gate is None else self.gate.node

    def _reply_listener(self) -> Callable[[DeviceReply], None]:
        before = self._node

        def take_gate(reply: DeviceReply) -> None:
            # The first report of the next node may overtake a reply, which then is of a node that has ended.
            if reply.gate is not None and self._node in (before, reply.gate.node):
                self.take(reply.gate)

        return take_gate


class RemoteRobot(ActingDevice):
    """Proxy of a robot; see `Robot`."""

    def __init__(self, link: Link, clock: Clock, daemon: str | None = None) -> None:
        super().__init__(link, "robot", clock, daemon)

    async def connect(self) -> JointState:
        return await self.call("connect", JointState, CONNECTING_TIME)

    async def disconnect(self) -> None:
        await self.call("disconnect", type(None), DISCONNECTING_TIME)

    async def joints(self) -> JointState:
        return await self.call("joints", JointState)

    async def follow(self, trajectory: JointTrajectory) -> MotionResult:
        return await self.act("follow", MotionResult, trajectory.duration + MOTION_MARGIN, trajectory=trajectory)

    async def press(self, request: PressRequest) -> MotionResult:
        return await self.act("press", MotionResult, request.timeout + MOTION_MARGIN, request=request)

    async def begin_servo(self) -> ServoSession:
        return await self.act("begin_servo", ServoSession)

    async def end_servo(self, session: int) -> MotionResult:
        return await self.call("end_servo", MotionResult, session=session)

    def servo(self) -> AbstractAsyncContextManager[ServoStream]:
        return servo_session(self, self._put, self._clock)

    async def hold(self) -> JointState:
        return await self.end(JointState)

    async def stop(self) -> JointState:
        return await self.end(JointState, latch=True)

    def _put(self, setpoint: JointSetpoint) -> None:
        self._link.publish("dev/robot/setpoint", msgspec.structs.replace(setpoint, token=self.token()))


class RemotePointer(ActingDevice):
    """Proxy of a pointer; see `Pointer`."""

    def __init__(self, link: Link, clock: Clock, touch_timeout: float, daemon: str | None = None) -> None:
        super().__init__(link, "pointer", clock, daemon)
        self._touch_timeout = touch_timeout

    async def touch(self, prompt: LandmarkPrompt) -> None:
        await self._take_over()
        await self.act("touch", type(None), self._touch_timeout, prompt=prompt)

    async def touch_surface(self) -> None:
        await self._take_over()
        await self.act("touch_surface", type(None), self._touch_timeout)

    async def slide(self) -> None:
        await self._take_over()
        await self.act("slide", type(None), self._touch_timeout)

    async def release(self) -> None:
        await self.end(type(None))

    async def _take_over(self) -> None:
        """Hold the pointer once for this daemon.

        It has no latch to release: it acts for the daemon that held it last.
        """
        if self.gate is None or self.gate.daemon != self._daemon:
            await self.release()


class RemoteStimulator(ActingDevice):
    """Proxy of a stimulator; see `Stimulator`."""

    def __init__(self, link: Link, clock: Clock, daemon: str | None = None) -> None:
        super().__init__(link, "stimulator", clock, daemon)

    async def state(self) -> StimulatorState:
        return await self.call("state", StimulatorState)

    async def set_intensity(self, percent: float) -> StimulatorState:
        return await self.act("set_intensity", StimulatorState, percent=percent)

    async def arm(self) -> StimulatorState:
        return await self.act("arm", StimulatorState, CHARGING_TIME)

    async def disarm(self) -> StimulatorState:
        return await self.end(StimulatorState)

    async def stop(self) -> StimulatorState:
        return await self.end(StimulatorState, latch=True)

    async def fire(self, number: int) -> FiredPulse:
        return await self.act("fire", FiredPulse, number=number)


class RemoteEmg(RemoteDevice):
    """Proxy of an electromyograph; see `Emg`."""

    def __init__(self, link: Link, clock: Clock) -> None:
        super().__init__(link, "emg", clock)

    async def epoch(self, pulse: int, before: float, after: float) -> Epoch:
        return await self.call("epoch", Epoch, after + ANSWER_TIME, pulse=pulse, before=before, after=after)


class RemoteScene(RemoteDevice):
    """Proxy of a simulated scene; see `Scene`."""

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
