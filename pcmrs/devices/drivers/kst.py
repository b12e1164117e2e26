"""KUKA LBR iiwa through the KUKA Sunrise Toolbox (KST), by TCP.

Written from the public source of the KST 1.7 server (MatlabToolboxServer, Sunrise 1.x) and its clients, and tested
against our virtual cabinet. Not tested on hardware. Motion is a stream of joint set points, because a point-to-point
motion of the cabinet cannot be stopped; without the controller's servo option it is a series of such motions, each so
short that none needs to be stopped. If the link is lost, the real cabinet stays at the
last set point. `disconnect` ends the KST application, which accepts one client only: start it again before the next
`connect`. The cabinet's control law for direct servo closes small errors slowly, so a real arm may come to rest a
little off its set point. The published joints are the measured ones.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Collection, Mapping
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from typing import Any

import structlog

from pcmrs.clock import Clock
from pcmrs.devices.kst.connection import JOINTS, KstConnection
from pcmrs.devices.kst.drive import Drive
from pcmrs.devices.kst.segment_drive import SegmentDrive
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
"""Time within which a held arm stands still, s."""
ONE_CLIENT = "It accepts several clients but answers only one: make sure that no other is connected."
NOT_CONNECTED = "The robot is not connected; connect it first."

log = structlog.get_logger(__name__)


class KstRobot:
    """Implementation of `pcmrs.devices.protocols.RobotDriver`; there are no states while it is not connected.

    Args:
        settings: Address of the cabinet, and parameters of the stream.
        model: Model of the arm.
        force: Limits of the force on the tool.
        clock: Clock that paces the stream, and for time stamps.

    Attributes:
        sessions: Servo sessions.
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
            await drive.rest()  # for a fresh reading: the newest one may be older if this process was held up
        return drive.state

    async def disconnect(self) -> None:
        if self._drive is not None:
            self._drive.follower.hold()
        async with self._connecting:  # a new connection would end the stream that brakes
            drive, self._drive = self._drive, None  # from here on no motion can begin
            self._lost = None
            if drive is not None:
                await self._end_connection(drive)

    async def joints(self) -> JointState:
        drive = self._connected()
        await drive.reading()  # of a cabinet that has gone silent, the last one says nothing
        return drive.state

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
        await drive.reading()  # one from before the hold does not confirm it
        if drive.busy:
            await drive.rest()
        return drive.state

    def states(self) -> AsyncIterator[JointState]:
        return self._states.read()

    def events(self) -> AsyncIterator[DeviceEvent]:
        return self._events.read()

    async def close(self) -> None:
        """Brake, and end the connection and all readers."""
        with suppress(PcmrsError):  # a lost link was reported already
            await self.disconnect()
        await self._stop_driving()
        self._states.close()
        self._events.close()

    async def _open(self) -> Drive:
        """Open a new connection: nothing of an earlier one is sent, and the reference starts at the measured joints."""
        await self._stop_driving()
        own = self._settings
        cabinet = await KstConnection.open(own.host, own.port, self._clock, own.connect_timeout, own.reply_timeout)
        try:
            posture = await cabinet.joints()
        except BaseException as error:
            cabinet.end()
            if isinstance(error, UnknownOutcomeError):
                raise UnknownOutcomeError(f"{error.text} {ONE_CLIENT}", **error.fields) from None
            raise
        kind = SegmentDrive if own.motion == "ptp" else Drive
        drive = kind(
            cabinet, posture, own, self._model, self._force, self._clock, self._states.publish, self._events.publish
        )
        self._drive, self._lost, self.sessions.servo = drive, None, None
        self._driving = asyncio.create_task(self._run(drive), name="KST drive")
        try:
            await drive.rest()  # until the first reading
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
        """End a connection whose `connect` has failed, so that the caller has none."""
        if self._drive is drive:
            self._drive = None
            await self._stop_driving()
            await drive.end()

    async def _run(self, drive: Drive) -> None:
        try:
            await drive.run()
        except UnknownOutcomeError as error:
            lost = error
        except Exception as error:  # a defect of this driver must not leave the arm unwatched
            log.exception("kst_drive_failed")
            lost = UnknownOutcomeError(f"The driver of the robot has failed: {error}. Look at the arm, connect again.")
        if self._drive is drive:
            self._drive, self._lost = None, lost
            event = DeviceEvent(device="robot", code="link_lost", text=lost.text, danger=True, fields=lost.fields)
            self._events.publish(event)
        await drive.end()  # after a defect the link still works, and the cabinet accepts no second one

    async def _stop_driving(self) -> None:
        if self._driving is not None:
            self._driving.cancel()
            with suppress(asyncio.CancelledError):
                await self._driving
            self._driving = None

    async def _end(self, drive: Drive, force: Callable[[], float] | None = None) -> MotionResult:
        """Wait until the arm rests, and return the outcome of the motion with the `force` measured then."""
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
        """Return the drive for a new motion, which starts at the measured joints."""
        drive = self._connected()
        self.sessions.check_free(drive.follower, drive.busy)
        drive.follower.stand(drive.arm.positions.copy())
        return drive


async def _held_unless_done(drive: Drive, waiting: Awaitable[None]) -> None:
    """Wait, and brake if the caller is cancelled, because then nobody waits for the end of the motion."""
    try:
        await waiting
    except asyncio.CancelledError:
        drive.follower.hold()
        raise


@asynccontextmanager
async def open_devices(
    devices: Collection[str], settings: Mapping[str, Any], clock: Clock
) -> AsyncIterator[Mapping[str, Any]]:
    """Open the robot, which is not connected yet; see `pcmrs.devices.protocols.OpenDriver`.

    Args:
        devices: Only ``robot``.
        settings: Whole configuration as plain data; ``kst`` and ``robot`` are read.
        clock: Clock of the machine: a real arm does not run faster.

    Raises:
        ConfigurationError: Another device is requested, a table is wrong, the arm is not an iiwa, or it must relieve a
            force while it cannot be stopped.
    """
    check_devices("kst", devices, "robot")
    own, force = read_table(settings, "kst", KstSettings), read_table(settings, "robot", ForceSettings)
    facts = find_arm(settings.get("robot", {}).get("model", "iiwa14"))
    if len(facts.joints) != JOINTS:
        text = f"The driver kst moves arms of {JOINTS} joints; robot.model {facts.name} has {len(facts.joints)}."
        raise ConfigurationError(text, model=facts.name)
    if own.motion == "ptp" and force.relief_mm > 0.0:
        text = (
            f'robot.relief_mm is {force.relief_mm:g}, but with kst.motion = "ptp" the arm cannot move back along a '
            "force while it acts: set robot.relief_mm = 0."
        )
        raise ConfigurationError(text, relief_mm=force.relief_mm)
    robot = KstRobot(own, ArmModel(facts), force, clock)
    try:
        yield {"robot": robot} if "robot" in devices else {}
    finally:
        await robot.close()
