"""KUKA LBR iiwa through the KUKA Sunrise Toolbox (KST), by TCP.

Written from the public source of the KST 1.7 server (MatlabToolboxServer, Sunrise 1.x) and its clients, and run against
our virtual cabinet. Not tested on hardware. All motion that must be stoppable is a stream of joint set points, for a
point-to-point motion of the cabinet cannot be stopped. When the link is lost, the real cabinet stays at the last set
point. `disconnect` ends the KST application, which accepts one client only: start it again before the next `connect`.
The cabinet's own law for direct servo closes small errors slowly, so that a real arm may come to rest a little off its
set point; what is published is what was measured.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from typing import Any

import structlog

from pcmrs.clock import Clock
from pcmrs.devices.kst.cabinet import JOINTS, Cabinet
from pcmrs.devices.kst.drive import Drive
from pcmrs.devices.kst.settings import KstSettings
from pcmrs.devices.motion.force import ForceSettings
from pcmrs.devices.motion.sessions import Sessions
from pcmrs.devices.protocols import ServoStream
from pcmrs.devices.servo import servo_session
from pcmrs.devices.stream import Stream
from pcmrs.devices.tables import check_devices, read_table
from pcmrs.errors import ConfigurationError, DeviceError, PcmrsError, UnknownOutcomeError
from pcmrs.kinematics.model import ArmModel
from pcmrs.kinematics.urdf_arms import find_arm
from pcmrs.messages import (
    DeviceEvent,
    JointSetpoint,
    JointState,
    JointTrajectory,
    MotionResult,
    PressRequest,
    ServoSession,
)

__all__ = ["KstRobot", "KstSettings", "open_devices"]

END_TIMEOUT = 2.0
"""An arm stands still so long after it was told to hold, s."""
ONE_CLIENT = "It accepts several clients and answers one: see that no other is connected."
NOT_CONNECTED = "The robot is not connected; connect it first."

log = structlog.get_logger(__name__)


class KstRobot:
    """Implements `pcmrs.devices.protocols.RobotDriver`; while it is not connected there are no states.

    Args:
        settings: Where the cabinet is, and how to stream.
        model: The arm.
        force: When the force on the tool is too great.
        clock: Paces the stream and stamps what is sent.

    Attributes:
        sessions: Of set points.
    """

    def __init__(self, settings: KstSettings, model: ArmModel, force: ForceSettings, clock: Clock) -> None:
        self._settings, self._model, self._force, self._clock = settings, model, force, clock
        self._states: Stream[JointState] = Stream()
        self._events: Stream[DeviceEvent] = Stream()
        self._connecting = asyncio.Lock()
        self._drive: Drive | None = None
        self._driving: asyncio.Task[None] | None = None
        self._lost: UnknownOutcomeError | None = None
        self.sessions = Sessions()

    @property
    def trouble(self) -> str:
        if self._drive is not None:
            return ""
        return self._lost.text if self._lost is not None else NOT_CONNECTED

    @property
    def dropped(self) -> int:
        return self.sessions.dropped

    async def connect(self) -> JointState:
        async with self._connecting:
            known = self._drive
            drive = known or await self._open()
        if drive is known:
            await drive.rest()  # seen anew: the newest reading may be of before this process was held up
        return drive.state

    async def disconnect(self) -> None:
        if self._drive is not None:
            self._drive.follower.hold()
        async with self._connecting:  # which would end the stream that brakes
            drive, self._drive = self._drive, None  # nothing begins any more
            self._lost = None
            if drive is not None:
                await self._end_connection(drive)

    async def joints(self) -> JointState:
        return self._connected().state

    async def follow(self, trajectory: JointTrajectory) -> MotionResult:
        drive = self._free()
        drive.follower.follow(trajectory)
        return await self._end(drive)

    async def press(self, request: PressRequest) -> MotionResult:
        drive = self._free()
        press = drive.follower.press(request)
        return await self._end(drive, lambda: press.force)

    async def begin_servo(self) -> ServoSession:
        drive = self._free()
        session = self.sessions.begin(drive.follower)
        await _held_unless_done(drive, drive.started())
        return session

    async def end_servo(self, session: int) -> MotionResult:
        drive = self._connected()
        self.sessions.end(session, drive.follower)
        return await self._end(drive)

    def servo(self) -> AbstractAsyncContextManager[ServoStream]:
        return servo_session(self, self.set_point, self._clock)

    def set_point(self, setpoint: JointSetpoint) -> None:
        self.sessions.take(setpoint, self._drive.follower if self._drive is not None else None)

    async def hold(self) -> JointState:
        drive = self._connected()
        drive.follower.hold()
        if drive.busy:
            await drive.rest()
        return drive.state

    def states(self) -> AsyncIterator[JointState]:
        return self._states.read()

    def events(self) -> AsyncIterator[DeviceEvent]:
        return self._events.read()

    async def close(self) -> None:
        """Brakes, ends the connection and all readers."""
        with suppress(PcmrsError):  # a link that is lost is reported already
            await self.disconnect()
        await self._stop_driving()
        self._states.close()
        self._events.close()

    async def _open(self) -> Drive:
        """Begins anew: nothing of an earlier connection is sent, and the reference starts from the measured joints."""
        await self._stop_driving()
        own = self._settings
        cabinet = await Cabinet.open(own.host, own.port, self._clock, own.connect_timeout, own.reply_timeout)
        try:
            posture = await cabinet.joints()
        except BaseException as error:
            cabinet.end()
            if isinstance(error, UnknownOutcomeError):
                raise UnknownOutcomeError(f"{error.text} {ONE_CLIENT}", **error.fields) from None
            raise
        drive = Drive(
            cabinet, posture, own, self._model, self._force, self._clock, self._states.publish, self._events.publish
        )
        self._drive, self._lost, self.sessions.servo = drive, None, None
        self._driving = asyncio.create_task(self._run(drive), name="KST drive")
        try:
            await drive.rest()  # until it has been read once
        except BaseException:
            await self._abandon(drive)
            raise
        return drive

    async def _end_connection(self, drive: Drive) -> None:
        drive.follower.hold()
        try:
            async with self._clock.timeout(END_TIMEOUT):
                await drive.rest()
        except TimeoutError:
            log.warning("kst_not_at_rest", limit=END_TIMEOUT)
        finally:
            await self._stop_driving()
            await drive.end()

    async def _abandon(self, drive: Drive) -> None:
        """Who was told that the connection failed has none."""
        if self._drive is drive:
            self._drive = None
            await self._stop_driving()
            await drive.end()

    async def _run(self, drive: Drive) -> None:
        try:
            await drive.run()
        except UnknownOutcomeError as error:
            lost = error
        except Exception as error:  # a defect of ours; nobody would watch over the arm any more
            log.exception("kst_drive_failed")
            lost = UnknownOutcomeError(f"The driver of the robot has failed: {error}. Look at the arm, connect again.")
        if self._drive is drive:
            self._drive, self._lost = None, lost
            event = DeviceEvent(device="robot", code="link_lost", text=lost.text, danger=True, fields=lost.fields)
            self._events.publish(event)
        await drive.end()  # after a defect the link still works, and the cabinet takes no other one

    async def _stop_driving(self) -> None:
        if self._driving is not None:
            self._driving.cancel()
            with suppress(asyncio.CancelledError):
                await self._driving
            self._driving = None

    async def _end(self, drive: Drive, force: Callable[[], float] | None = None) -> MotionResult:
        """How the motion ended, once the arm rests; with the `force` measured then."""
        await _held_unless_done(drive, drive.rest())
        stopped = drive.follower.stopped
        return MotionResult(
            outcome="stopped" if stopped else "done",
            positions=drive.arm.positions.tolist(),
            reason=stopped,
            force=force() if force is not None else None,
        )

    def _connected(self) -> Drive:
        if self._drive is not None:
            return self._drive
        if self._lost is not None:
            raise UnknownOutcomeError(self._lost.text, **self._lost.fields)
        raise DeviceError(NOT_CONNECTED)

    def _free(self) -> Drive:
        """Accepts a new motion, from where the arm is measured."""
        drive = self._connected()
        self.sessions.check_free(drive.follower, drive.busy)
        drive.follower.stand(drive.arm.positions.copy())
        return drive


async def _held_unless_done(drive: Drive, waiting: Awaitable[None]) -> None:
    """Waits; brakes when the caller is cancelled, for nobody waits for the end any more."""
    try:
        await waiting
    except asyncio.CancelledError:
        drive.follower.hold()
        raise


@asynccontextmanager
async def open_devices(
    devices: Collection[str], settings: Mapping[str, Any], clock: Clock
) -> AsyncIterator[Mapping[str, Any]]:
    """Opens the robot, which is not connected yet; see `pcmrs.devices.protocols.OpenDriver`.

    Args:
        devices: ``robot`` only.
        settings: The whole configuration; ``kst`` and ``robot`` are read.
        clock: Of the machine: a real arm does not run faster.

    Raises:
        ConfigurationError: Another device is asked for, or a table is wrong, or the arm is no iiwa.
    """
    check_devices("kst", devices, "robot")
    own, force = read_table(settings, "kst", KstSettings), read_table(settings, "robot", ForceSettings)
    facts = find_arm(settings.get("robot", {}).get("model", "iiwa14"))
    if len(facts.joints) != JOINTS:
        text = f"The driver kst moves arms of {JOINTS} joints; robot.model {facts.name} has {len(facts.joints)}."
        raise ConfigurationError(text, model=facts.name)
    robot = KstRobot(own, ArmModel(facts), force, clock)
    try:
        yield {"robot": robot} if "robot" in devices else {}
    finally:
        await robot.close()
