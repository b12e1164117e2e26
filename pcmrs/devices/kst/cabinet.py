"""The commands of the KST server: mm and rad on the wire, SI here; angles are A(z) B(y) C(x)."""

from __future__ import annotations

import asyncio
from typing import Annotated, Self

import msgspec
import numpy as np
import numpy.typing as npt

from pcmrs.clock import Clock
from pcmrs.devices.kst.link import KstLink
from pcmrs.devices.kst.wire import parse_values, words
from pcmrs.errors import DeviceError, PayloadError, UnknownOutcomeError
from pcmrs.spatial import Floats

JOINTS = 7
DONE = "done"
SECOND_DONE = 0.3
"""KST 1.7 acknowledges the end of an impedance stream twice; the second one may come so much later, s."""
STRAY = 0.1
"""What was outstanding when a motion broke off comes within this, or not at all, s."""
PTP_TIMEOUT = 120.0
"""A point-to-point motion takes no longer, s."""
SPEEDS = (0.01, 1.0)
NotNegative = Annotated[float, msgspec.Meta(ge=0.0)]


class ImpedanceSettings(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The joint impedance of the cabinet's smart servo.

    Attributes:
        tool_mass: kg.
        tool_com_mm: Its centre of mass in the flange's axes, mm.
        translation_stiffness: N/m, at most 4000.
        rotation_stiffness: N m/rad, at most 300.
        null_space_stiffness: N m/rad.
    """

    tool_mass: NotNegative = 1.0
    tool_com_mm: tuple[float, float, float] = (0.0, 0.0, 80.0)
    translation_stiffness: Annotated[float, msgspec.Meta(ge=0.0, le=4000.0)] = 4000.0
    rotation_stiffness: Annotated[float, msgspec.Meta(ge=0.0, le=300.0)] = 300.0
    null_space_stiffness: NotNegative = 100.0


class Cabinet:
    """A connected KST server, one command at a time.

    Every method raises `DeviceRefusedError` or `MotionInterruptedError` as the cabinet answers, and
    `UnknownOutcomeError` when it does not, or answers something else: the link is lost then.

    Args:
        link: To it.
        timeout: For every reply, s.
    """

    def __init__(self, link: KstLink, timeout: float) -> None:
        self._link = link
        self._timeout = timeout

    @classmethod
    async def open(cls, host: str, port: int, clock: Clock, connect_timeout: float, timeout: float) -> Self:
        """Connects; see `KstLink.open`."""
        return cls(await KstLink.open(host, port, clock, connect_timeout), timeout)

    def check(self) -> None:
        """Raises what the cabinet has said unasked, or `UnknownOutcomeError` if the link fails; see `KstLink.check`."""
        self._link.check()

    async def drain(self) -> None:
        """Waits a little for what is outstanding after a motion broke off."""
        await self._link.drain(STRAY)

    async def joints(self) -> Floats:
        """Measured joints, rad, (7,)."""
        return await self._read("getJointsPositions", JOINTS)

    async def external_torques(self, patience: float = 0.0) -> Floats:
        """Joint torques by external forces, N m, (7,); their reply may come `patience` s later than others.

        The thread that answers is busy until an ended stream has brought the arm to rest.
        """
        (line,) = await self._link.ask("Torques_ext_J", self._timeout + patience)
        return self.values(line, JOINTS)

    async def measured_torques(self) -> Floats:
        """Joint torques as the sensors have them, N m, (7,)."""
        return await self._read("Torques_m_J", JOINTS)

    async def pose(self) -> Floats:
        """The tool frame in the base: x y z m, A B C rad, (6,)."""
        values = await self._read("Eef_pos", 6)
        return np.concatenate((values[:3] * 1e-3, values[3:]))

    async def force(self) -> Floats:
        """External force on the tool frame, N, (3,)."""
        return await self._read("Eef_force", 3)

    async def moment(self) -> Floats:
        """External moment on the tool frame, N m, (3,)."""
        return await self._read("Eef_moment", 3)

    async def set_tool_frame(self, translation: npt.ArrayLike, angles: npt.ArrayLike) -> None:
        """Puts the tool frame on the flange: x y z m, A B C rad, (3,) each."""
        await self._do(f"TFtrans_{_pose(translation, angles)}")

    async def ptp_joints(self, positions: npt.ArrayLike, speed: float) -> None:
        """Moves to joints, rad, (7,), with a part of the greatest speed; returns at the end. It cannot be stopped."""
        goal = f"jp_{_joints(positions)}"
        await self._set_speed(speed)
        await self._do(goal)
        await self._do("doPTPinJS", PTP_TIMEOUT)

    async def ptp_cartesian(self, translation: npt.ArrayLike, angles: npt.ArrayLike, speed: float) -> None:
        """Moves the tool frame to x y z m, A B C rad in the base; returns at the end. It cannot be stopped."""
        goal = f"cArtixanPosition_{_pose(translation, angles)}_"
        await self._set_speed(speed)
        await self._do(goal)
        await self._do("doPTPinCS", PTP_TIMEOUT)

    async def start_servo(self) -> None:
        """Begins to follow the stream of joints."""
        await self._do("startDirectServoJoints")

    async def start_impedance(self, settings: ImpedanceSettings, posture: npt.ArrayLike) -> None:
        """Begins to follow the stream of joints under impedance, at a posture where the arm stands, rad, (7,).

        The server takes joint 1 not from where the arm is but from the last joints it was told, so these come first.
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
        """Ends the stream of `start_servo`."""
        await self._do("stopDirectServoJoints", sure=True)

    async def stop_impedance(self) -> None:
        """Ends the stream of `start_impedance`."""
        for line in await self._link.ask_for_one_or_two("stopDirectServoJoints", self._timeout, SECOND_DONE):
            self._check_done(line)

    def stream(self, positions: npt.ArrayLike) -> None:
        """The next set point, rad, (7,), without any reply."""
        self._link.send(f"jf_{_joints(positions)}")

    def stream_for_joints(self, positions: npt.ArrayLike) -> asyncio.Future[str]:
        """The next set point; the measured joints come back, for `values`."""
        return self._link.send(f"jpJP_{_joints(positions)}", self._timeout, sure=True)[0]

    def stream_for_torques(self, positions: npt.ArrayLike) -> asyncio.Future[str]:
        """The next set point; the external torques come back, for `values`."""
        return self._link.send(f"jpExT_{_joints(positions)}", self._timeout, sure=True)[0]

    def values(self, line: str, count: int = JOINTS) -> Floats:
        """The numbers of a reply, (count,)."""
        try:
            return parse_values(line, count)
        except PayloadError as error:
            raise self._lost(error) from None

    def end(self) -> None:
        """Ends the KST application, as far as the link still can, and closes it."""
        self._link.close("end")

    async def _set_speed(self, speed: float) -> None:
        if not SPEEDS[0] <= speed <= SPEEDS[1]:
            text = f"The relative joint speed is {speed:g}, must be {SPEEDS[0]:g} to {SPEEDS[1]:g}; nothing was moved."
            raise DeviceError(text, speed=speed)
        await self._do(f"jRelVel_{speed:.4g}_")

    async def _read(self, command: str, count: int) -> Floats:
        (line,) = await self._link.ask(command, self._timeout)
        return self.values(line, count)

    async def _do(self, command: str, *further: float, sure: bool = False) -> None:
        for line in await self._link.ask(command, self._timeout, *further, sure=sure):
            self._check_done(line)

    def _check_done(self, line: str) -> None:
        if line != DONE:
            raise self._lost(PayloadError(f"The cabinet answered {line[:40]!r}, not {DONE!r}.", line=line[:40]))

    def _lost(self, error: PayloadError) -> UnknownOutcomeError:
        """After a reply that is none of ours nobody knows which reply belongs to what."""
        return self._link.fail(error.text.rstrip("."))


def _joints(positions: npt.ArrayLike) -> str:
    values = np.asarray(positions, dtype=float)
    if values.shape != (JOINTS,):
        raise DeviceError(f"The cabinet's arm has {JOINTS} joints, not {values.shape}; nothing was sent.")
    return f"{words(values)}_"


def _pose(translation: npt.ArrayLike, angles: npt.ArrayLike) -> str:
    return words((*(np.asarray(translation, dtype=float) * 1e3), *np.asarray(angles, dtype=float)))
