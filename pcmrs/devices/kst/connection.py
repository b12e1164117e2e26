"""Commands of the KST server: mm and rad on the wire, SI units here; angles are A (about z), B (y) and C (x)."""

from __future__ import annotations

import asyncio
from typing import Annotated, Self

import msgspec
import numpy as np
import numpy.typing as npt

from pcmrs.clock import Clock
from pcmrs.devices.kst.link import DONE, KstLink
from pcmrs.devices.kst.wire import parse_values, words
from pcmrs.errors import DeviceError, PayloadError, UnknownOutcomeError
from pcmrs.spatial import Floats

JOINTS = 7
SECOND_DONE = 0.3
"""Longest time between the two acknowledgements with which KST 1.7 ends an impedance stream, s."""
LATE_REPLY_TIME = 0.1
"""Time within which replies that were outstanding when a motion was broken off arrive, if at all, s."""
PTP_TIMEOUT = 120.0
"""Longest duration of a point-to-point motion, s."""
SPEEDS = (0.01, 1.0)
"""Range of the relative joint speed of a point-to-point motion."""
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]


class ImpedanceSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Impedance of the cabinet's smart servo.

    Attributes:
        tool_mass: Mass of the tool, kg.
        tool_com_mm: Centre of mass of the tool in the flange's axes, mm.
        translation_stiffness: Stiffness in translation, N/m, at most 4000.
        rotation_stiffness: Stiffness in rotation, N m/rad, at most 300.
        null_space_stiffness: Stiffness of the redundant joint motion, N m/rad.
    """

    tool_mass: NotNegative = 1.0
    tool_com_mm: tuple[float, float, float] = (0.0, 0.0, 80.0)
    translation_stiffness: Annotated[float, msgspec.Meta(ge=0.0, le=4000.0)] = 4000.0
    rotation_stiffness: Annotated[float, msgspec.Meta(ge=0.0, le=300.0)] = 300.0
    null_space_stiffness: NotNegative = 100.0


class KstConnection:
    """A connected KST server, one command at a time.

    Every method raises `DeviceRefusedError` or `MotionInterruptedError` if the cabinet answers so, and
    `UnknownOutcomeError` if it does not answer, or with something else: the link is lost then.

    Args:
        link: Link to the cabinet.
        timeout: Longest wait for a reply, s.
    """

    def __init__(self, link: KstLink, timeout: float) -> None:
        self._link = link
        self._timeout = timeout

    @classmethod
    async def open(cls, host: str, port: int, clock: Clock, connect_timeout: float, timeout: float) -> Self:
        """Connect; see `KstLink.open`.

        Args:
            host: Host name or address of the cabinet.
            port: TCP port of the KST application.
            clock: Clock for deadlines.
            connect_timeout: Longest wait for the connection, s.
            timeout: Longest wait for a reply, s.
        """
        return cls(await KstLink.open(host, port, clock, connect_timeout), timeout)

    def check(self) -> None:
        """Raise an error that the cabinet reported by itself, or `UnknownOutcomeError` if the link has failed.

        See `KstLink.check`.
        """
        self._link.check()

    async def drain(self) -> None:
        """Wait at most `LATE_REPLY_TIME` for outstanding replies after a motion was broken off."""
        await self._link.drain(LATE_REPLY_TIME)

    async def joints(self) -> Floats:
        """Return the measured joints, rad, (7,)."""
        return await self._read("getJointsPositions", JOINTS)

    async def external_torques(self, patience: float = 0.0) -> Floats:
        """Return the joint torques by external forces, N m, (7,).

        Args:
            patience: Additional wait for the reply, s: the thread that answers is busy until the arm is at rest after a
                stream.
        """
        (line,) = await self._link.request("Torques_ext_J", self._timeout + patience)
        return self.values(line, JOINTS)

    async def measured_torques(self) -> Floats:
        """Return the joint torques as the sensors measure them, N m, (7,)."""
        return await self._read("Torques_m_J", JOINTS)

    async def pose(self) -> Floats:
        """Return the pose of the tool frame in the base: x y z m, A B C rad, (6,)."""
        values = await self._read("Eef_pos", 6)
        return np.concatenate((values[:3] * 1e-3, values[3:]))

    async def force(self) -> Floats:
        """Return the external force on the tool frame, N, (3,)."""
        return await self._read("Eef_force", 3)

    async def moment(self) -> Floats:
        """Return the external moment on the tool frame, N m, (3,)."""
        return await self._read("Eef_moment", 3)

    async def set_tool_frame(self, translation: npt.ArrayLike, angles: npt.ArrayLike) -> None:
        """Set the tool frame in the flange frame.

        Args:
            translation: x y z, m, (3,).
            angles: A B C, rad, (3,).
        """
        await self._do(f"TFtrans_{_pose(translation, angles)}")

    async def ptp_joints(self, positions: npt.ArrayLike, speed: float) -> None:
        """Move to a posture, and return at its end. The motion cannot be stopped.

        Args:
            positions: Joint positions, rad, (7,).
            speed: Part of the greatest joint speed, within `SPEEDS`.
        """
        await self.prepare_ptp(positions, speed)
        await self._do("doPTPinJS", PTP_TIMEOUT)

    async def ptp_cartesian(self, translation: npt.ArrayLike, angles: npt.ArrayLike, speed: float) -> None:
        """Move the tool frame to a pose in the base frame, and return at its end. The motion cannot be stopped.

        Args:
            translation: x y z, m, (3,).
            angles: A B C, rad, (3,).
            speed: Part of the greatest joint speed, within `SPEEDS`.
        """
        goal = f"cArtixanPosition_{_pose(translation, angles)}_"
        await self._set_speed(speed)
        await self._do(goal)
        await self._do("doPTPinCS", PTP_TIMEOUT)

    async def prepare_ptp(self, positions: npt.ArrayLike, speed: float) -> None:
        """Set speed and goal of the next `start_ptp`; nothing moves.

        Args:
            positions: Joint positions, rad, (7,).
            speed: Part of the greatest joint speed, within `SPEEDS`.
        """
        goal = f"jp_{_joints(positions)}"
        await self._set_speed(speed)
        await self._do(goal)

    async def start_ptp(self, duration: float) -> asyncio.Future[str]:
        """Start to move to the prepared posture, and return when the cabinet has accepted that.

        The motion cannot be stopped. `stream_for_joints` and `stream_for_torques` with its goal read the moving arm.

        Args:
            duration: Planned duration of the motion, s.

        Returns:
            Future of the reply at its end, for `check_ended`.
        """
        return await self._link.start_motion("doPTPinJS", self._timeout, duration)

    def check_ended(self, ended: asyncio.Future[str]) -> None:
        """Check that a motion has reached its end.

        Args:
            ended: Future of `start_ptp`, which is done.
        """
        self._check_done(ended.result())

    async def start_servo(self) -> None:
        """Start to follow the stream of joints."""
        await self._do("startDirectServoJoints")

    async def start_impedance(self, settings: ImpedanceSettings, posture: npt.ArrayLike) -> None:
        """Start to follow the stream of joints under impedance control.

        The server takes joint 1 from the last commanded joints, not from the measured ones, so the posture is sent
        first.

        Args:
            settings: Impedance and load.
            posture: Present posture of the arm, at rest, rad, (7,).
        """
        values = (
            settings.tool_mass,
            *settings.tool_com_mm,
            settings.translation_stiffness,
            settings.rotation_stiffness,
            settings.null_space_stiffness,
        )
        await self._do(f"jp_{_joints(posture)}")
        await self._do(f"startSmartImpedneceJoints_{words(values)}_")

    async def stop_servo(self) -> None:
        """End the stream of `start_servo`."""
        await self._do("stopDirectServoJoints", sure=True)

    async def stop_impedance(self) -> None:
        """End the stream of `start_impedance`."""
        for line in await self._link.request_one_or_two("stopDirectServoJoints", self._timeout, SECOND_DONE):
            self._check_done(line)

    def stream(self, positions: npt.ArrayLike) -> None:
        """Send the next set point, rad, (7,), without any reply."""
        self._link.send(f"jf_{_joints(positions)}")

    def stream_for_joints(self, positions: npt.ArrayLike) -> asyncio.Future[str]:
        """Send the next set point, rad, (7,); the reply holds the measured joints, for `values`."""
        return self._link.send(f"jpJP_{_joints(positions)}", self._timeout, sure=True)[0]

    def stream_for_torques(self, positions: npt.ArrayLike) -> asyncio.Future[str]:
        """Send the next set point, rad, (7,); the reply holds the external torques, for `values`."""
        return self._link.send(f"jpExT_{_joints(positions)}", self._timeout, sure=True)[0]

    def values(self, line: str, count: int = JOINTS) -> Floats:
        """Return the numbers of a reply.

        Args:
            line: Reply.
            count: Number of values that it must hold.

        Raises:
            UnknownOutcomeError: The reply holds something else; the link is lost then.
        """
        try:
            return parse_values(line, count)
        except PayloadError as error:
            raise self._lost(error) from None

    def end(self) -> None:
        """End the KST application if the link still works, and close the link."""
        self._link.close("end")

    async def _set_speed(self, speed: float) -> None:
        if not SPEEDS[0] <= speed <= SPEEDS[1]:
            text = f"The relative joint speed is {speed:g}, must be {SPEEDS[0]:g} to {SPEEDS[1]:g}; nothing was moved."
            raise DeviceError(text, speed=speed)
        await self._do(f"jRelVel_{speed:.4g}_")

    async def _read(self, command: str, count: int) -> Floats:
        (line,) = await self._link.request(command, self._timeout)
        return self.values(line, count)

    async def _do(self, command: str, *further: float, sure: bool = False) -> None:
        for line in await self._link.request(command, self._timeout, *further, sure=sure):
            self._check_done(line)

    def _check_done(self, line: str) -> None:
        if line != DONE:
            raise self._lost(PayloadError(f"The cabinet answered {line[:40]!r}, not {DONE!r}.", line=line[:40]))

    def _lost(self, error: PayloadError) -> UnknownOutcomeError:
        """Fail the link after an unexpected reply: later replies can no longer be assigned to their commands."""
        return self._link.fail(error.text.rstrip("."))


def _joints(positions: npt.ArrayLike) -> str:
    values = np.asarray(positions, dtype=float)
    if values.shape != (JOINTS,):
        raise DeviceError(f"The cabinet's arm has {JOINTS} joints, not {values.shape}; nothing was sent.")
    return f"{words(values)}_"


def _pose(translation: npt.ArrayLike, angles: npt.ArrayLike) -> str:
    return words((*(np.asarray(translation, dtype=float) * 1e3), *np.asarray(angles, dtype=float)))
