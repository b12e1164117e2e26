"""Fake devices for tests: each answers at once, records its requests, and fails if the test demands it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import AbstractAsyncContextManager
from typing import Any

from pcmrs.devices.protocols import ServoStream
from pcmrs.devices.servo import servo_session
from pcmrs.errors import DeviceError
from pcmrs.messages import (
    BodyPose,
    DeviceEvent,
    Epoch,
    FiredPulse,
    HeadMotion,
    JointSetpoint,
    JointState,
    JointTrajectory,
    LandmarkPrompt,
    MotionResult,
    PoseMessage,
    PressRequest,
    SceneTruth,
    ServoSession,
    StimulatorState,
)
from pcmrs.testing.clock import ManualClock

__all__ = ["FakeEmg", "FakeHand", "FakeRobot", "FakeStimulator", "FakeTracker"]

SESSION = 4
"""Number of the servo session of `FakeRobot`."""
STATE = JointState(captured=1.0, sent=1.0, positions=[0.1] * 7, velocities=[0.0] * 7, torques=[0.0] * 7)
"""Joints of an arm at rest, rad."""
END = JointSetpoint(session=0, number=0, sent=0.0, positions=[], velocities=[])
"""Marks the end of a session among the set points of `FakeRobot`."""
ORIGIN = PoseMessage(position=(0.0, 0.0, 0.0), quat_wxyz=(1.0, 0.0, 0.0, 0.0))
"""The pose of a body whose frame is that of the tracker."""
EPOCH = Epoch(pulse=1, muscle="FDI", rate_hz=5000.0, start=-0.1, samples=[0.0, 1e-5])
"""The signal around pulse 1, V."""


class FakeRobot:
    """A robot that performs requests at once, and records them.

    Attributes:
        error: Error that calls raise; None for a robot that answers.
        state: Measured joints.
        followed: Requested trajectories, in order.
        pressed: Requested presses, in order.
        holds: Number of holds.
        setpoints: Set points in order; `END` at the end of a session.
        servo_end: Result of servo sessions.
        stream: Queue of joint states that it publishes.
        reports: Queue of events that it reports.
    """

    trouble = ""
    dropped = 0

    def __init__(self) -> None:
        self.error: Exception | None = None
        self.state = STATE
        self.followed: list[JointTrajectory] = []
        self.holds = 0
        self.stream: asyncio.Queue[JointState] = asyncio.Queue()
        self.reports: asyncio.Queue[DeviceEvent] = asyncio.Queue()
        self.setpoints: list[JointSetpoint] = []
        self.pressed: list[PressRequest] = []
        self.servo_end = MotionResult(outcome="done", positions=[0.1] * 7)

    async def connect(self) -> JointState:
        if self.error is not None:
            raise self.error
        return STATE

    async def disconnect(self) -> None:
        await asyncio.sleep(0)

    async def joints(self) -> JointState:
        return self.state

    async def follow(self, trajectory: JointTrajectory) -> MotionResult:
        self.followed.append(trajectory)
        return MotionResult(outcome="done", positions=trajectory.positions[-1])

    async def press(self, request: PressRequest) -> MotionResult:
        self.pressed.append(request)
        return MotionResult(outcome="done", positions=[0.1] * 7, force=3.1)

    async def begin_servo(self) -> ServoSession:
        return ServoSession(session=SESSION, deadman=0.1)

    async def end_servo(self, session: int) -> MotionResult:
        if session != SESSION:
            raise DeviceError(f"There is no session {session}; the only session is {SESSION}.", session=session)
        self.setpoints.append(END)
        if self.error is not None:
            raise self.error
        return self.servo_end

    def servo(self) -> AbstractAsyncContextManager[ServoStream]:
        return servo_session(self, self.set_point, ManualClock())

    def set_point(self, setpoint: JointSetpoint) -> None:
        self.setpoints.append(setpoint)

    async def hold(self) -> JointState:
        self.holds += 1
        if self.error is not None:
            raise self.error
        return STATE

    async def states(self) -> AsyncIterator[JointState]:
        while True:
            yield await self.stream.get()

    async def events(self) -> AsyncIterator[DeviceEvent]:
        while True:
            yield await self.reports.get()


class FakeTracker:
    """A tracker that publishes the frames of a test.

    Attributes:
        trouble: Reported reason why it sends no frames.
        stream: Queue of frames that it publishes.
    """

    trouble = "The tracker is unplugged."

    def __init__(self) -> None:
        self.stream: asyncio.Queue[Sequence[BodyPose]] = asyncio.Queue()

    async def frames(self) -> AsyncIterator[Sequence[BodyPose]]:
        while True:
            yield await self.stream.get()


class FakeHand:
    """A pointer and a scene in one, which only records its requests; its body and tool lie at the tracker's origin.

    Attributes:
        calls: Requests, in order.
    """

    def __init__(self) -> None:
        self.calls: list[Any] = []

    async def touch(self, prompt: LandmarkPrompt) -> None:
        self.calls.append(prompt)

    async def touch_surface(self) -> None:
        self.calls.append("surface")

    async def slide(self) -> None:
        self.calls.append("slide")

    async def release(self) -> None:
        self.calls.append("release")

    async def truth(self) -> SceneTruth:
        return SceneTruth(tracker_from_coil=ORIGIN, tracker_from_body_ref=ORIGIN, body_ref_from_image=ORIGIN)

    async def occlude(self, body: str, hidden: bool) -> None:
        self.calls.append((body, hidden))

    async def move_body(self, offset_in_tracker: tuple[float, float, float]) -> None:
        self.calls.append(offset_in_tracker)

    async def cut_robot(self, cut: bool) -> None:
        self.calls.append(cut)

    async def inject(self, fault: str, arguments: dict[str, Any]) -> None:
        self.calls.append((fault, arguments))

    async def displace_touch(self, index: int, offset_in_image: tuple[float, float, float]) -> None:
        self.calls.append((index, offset_in_image))

    async def reseed(self, seed: int) -> None:
        self.calls.append(seed)

    async def set_motion(self, motion: HeadMotion) -> None:
        self.calls.append(motion)

    async def bump_reference(self, offset_in_body_ref: Any, rotvec: Any) -> None:
        self.calls.append((offset_in_body_ref, rotvec))

    async def pivot_pointer(self, duration: float) -> None:
        self.calls.append(duration)


class FakeStimulator:
    """A stimulator that is charged at once.

    Attributes:
        armed: True if it can fire.
        intensity: Intensity, percent of the maximum stimulator output.
        pulse: Number of the last pulse.
        disarms: Number of disarm requests.
        error: Error that calls raise; None for a stimulator that answers.
        reports: Queue of events that it reports.
    """

    def __init__(self) -> None:
        self.armed = False
        self.intensity = 50.0
        self.pulse = 0
        self.disarms = 0
        self.error: Exception | None = None
        self.reports: asyncio.Queue[DeviceEvent] = asyncio.Queue()

    async def state(self) -> StimulatorState:
        if self.error is not None:
            raise self.error
        return StimulatorState(
            armed=self.armed, ready=True, intensity=self.intensity, coil_temperature=None, pulse=self.pulse
        )

    async def set_intensity(self, percent: float) -> StimulatorState:
        self.intensity = percent
        return await self.state()

    async def arm(self) -> StimulatorState:
        self.armed = True
        return await self.state()

    async def disarm(self) -> StimulatorState:
        self.disarms += 1
        self.armed = False
        return await self.state()

    async def fire(self, number: int) -> FiredPulse:
        self.pulse = number
        return FiredPulse(number=number, intensity=self.intensity, fired=1.0)

    async def events(self) -> AsyncIterator[DeviceEvent]:
        while True:
            yield await self.reports.get()


class FakeEmg:
    """An electromyograph that has received the marker of pulse 1 only."""

    async def epoch(self, pulse: int, before: float, after: float) -> Epoch:  # noqa: ARG002 - as the protocol has it
        if pulse != EPOCH.pulse:
            raise DeviceError(f"No marker of pulse {pulse} was received.", pulse=pulse)
        return EPOCH
