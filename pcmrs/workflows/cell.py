"""The cell as operations see it: devices, calibrations, and where everything is now."""

from __future__ import annotations

import asyncio
import hashlib
import math
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np
import structlog

from pcmrs.calibration import Calibration, Kind, read_calibration
from pcmrs.clock import Clock
from pcmrs.devices.poses import PoseFeed
from pcmrs.devices.protocols import Emg, LatchingRobot, LatchingStimulator, Pointer
from pcmrs.errors import ConfigurationError, FileFormatError, PcmrsError, RefusalError
from pcmrs.formats.mesh import Mesh
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointState
from pcmrs.spatial import Floats, Frame, FrameGraph, Transform
from pcmrs.workflows.data import PlacementData, Registered, as_transform
from pcmrs.workflows.settings import ProcedureSettings
from pcmrs.workflows.teleop_port import TeleopPort
from pcmrs.workflows.zones import CellZones

log = structlog.get_logger(__name__)


@dataclass
class Cell:
    """Devices and calibrations of one cell.

    Attributes:
        surface: Of the body, read once when the cell was opened, so that planning, guard and display have the same one
            even if the file has changed since. None where none is configured.
        joints: Newest measured joints; None until the robot has been heard.
        name: ``site/name`` of the cell.
        tool_calibration: From a file; None where the configuration gives the poses.
        pointer_calibration: The same of the pointer.
        resting_since: When the arm came to rest, s of the clock; poses captured earlier show it moving.
        initial_joints: Posture that `placement.to_initial` returns to; the home posture until one is remembered.
        base_from_body_ref: Where the body was last seen in the robot's base.
        base_from_tracker: Where the tracker was by that.
        body_ref_from_image: The registration that was in force last, also when it has been given up.
        middle_in_body_ref: Centre of the landmarks that were registered last, m, (3,): it stays where it is in the
            body when the registration is given up. None until this cell has seen a registration.
        earlier_body_ref_from_image: The last accepted registration of an earlier run, while none has been seen since
            and it still fits: the arm keeps away from where that has the body.
        watchers: Called with every newly measured joint state.
        zones: What the arm keeps out of.
        uses_robot: The workflow connects or moves the robot. Otherwise nobody has ever released the arm, if there is
            one: it is latched since it started, and neither a Stop nor its release waits for it.
        stimulator: None where none is configured.
        emg: The same.
        teleop: Where set points of teleoperators come in.
    """

    robot: LatchingRobot
    pointer: Pointer
    poses: PoseFeed
    arm: ArmModel
    clock: Clock
    settings: ProcedureSettings
    surface: Mesh | None
    joints: JointState | None = None
    resting_since: float = -math.inf
    base_from_body_ref: Transform | None = None
    base_from_tracker: Transform | None = None
    body_ref_from_image: Transform | None = None
    middle_in_body_ref: Floats | None = None
    earlier_body_ref_from_image: Transform | None = None
    initial_joints: list[float] | None = None
    watchers: list[Callable[[JointState], None]] = field(default_factory=list)
    name: str = "lab/cell1"
    uses_robot: bool = True
    stimulator: LatchingStimulator | None = None
    emg: Emg | None = None
    teleop: TeleopPort = field(default_factory=TeleopPort)
    flange_from_coil: Transform = field(init=False)
    pointer_from_tip: Transform = field(init=False)
    zones: CellZones = field(init=False)

    def __post_init__(self) -> None:
        calibration = self.settings.calibration
        self.flange_from_tool = calibration.flange_from_tool.transform()
        self.tool_from_coil = calibration.tool_from_coil.transform()
        self.flange_from_coil = self.flange_from_tool @ self.tool_from_coil
        self.pointer_from_tip = calibration.pointer_from_tip.transform()
        self.tool_calibration = _calibration("tool", calibration.tool_file)
        self.pointer_calibration = _calibration("pointer", calibration.pointer_file)
        if self.tool_calibration is not None:
            self.flange_from_coil = self.tool_calibration.transform()
            self.tool_from_coil = self.flange_from_tool.inverse() @ self.flange_from_coil
        if self.pointer_calibration is not None:
            self.pointer_from_tip = self.pointer_calibration.transform()
        self.zones = CellZones(self.arm.facts, self.flange_from_coil, self.settings, self.surface)

    @property
    def calibration_id(self) -> str:
        """Short hash of the calibrations in use: what was registered with another one is not comparable."""
        return _identity(self.tool_calibration, self.pointer_calibration, self.settings)

    def calibrations(self) -> dict[str, str]:
        """What is in use, for people: the calibration files, or ``explicit`` for poses of the configuration."""
        found = {"tool": self.tool_calibration, "pointer": self.pointer_calibration}
        return {kind: "explicit" if used is None else used.title() for kind, used in found.items()}

    def posture(self) -> Floats:
        """Measured joints at rest, rad, (n,).

        Raises:
            RefusalError: The robot has not been heard yet.
        """
        if self.joints is None:
            raise RefusalError("joints_unknown", "The robot has not reported its joints yet: connect it first.")
        return np.array(self.joints.positions)

    @property
    def home(self) -> tuple[float, ...]:
        """The home posture: as configured, or the arm's own; rad, base to flange."""
        return self.settings.home or self.arm.facts.home

    def update_joints(self, state: JointState) -> None:
        """Takes a newly measured joint state."""
        if state.moving:
            self.resting_since = self.clock.monotonic()
        self.joints = state
        for watch in tuple(self.watchers):
            watch(state)

    async def make_safe(self, latch: bool) -> None:
        """Holds the robot, if the workflow uses it, and disarms the stimulator, both at once.

        Args:
            latch: They act only after a release; not where only a motion is ended.

        Raises:
            PcmrsError: One of them has not confirmed it.
        """
        robot, stimulator = self.robot, self.stimulator
        asked: list[Awaitable[object]] = []
        if self.uses_robot:
            asked.append(robot.stop() if latch else robot.hold())
        if stimulator is not None:
            asked.append(stimulator.stop() if latch else stimulator.disarm())
        for answer in await asyncio.gather(*asked, return_exceptions=True):
            if isinstance(answer, BaseException):
                raise answer

    async def release(self, stopped: bool) -> list[str]:
        """Ends the latch of robot and stimulator, once the robot has confirmed that it stands, if it is used.

        Args:
            stopped: Robot and stimulator were stopped. Otherwise a robot that is not latched is left alone: it may
                move, and an acknowledgement that came too late must not hold it.

        Returns:
            Names of the devices that stay latched: a stimulator that does not answer, which must not keep anybody from
            retreating.

        Raises:
            DeviceError: The robot moves, was held once more meanwhile, or refuses.
            UnknownOutcomeError: It does not answer.
        """
        if self.uses_robot and (stopped or self.robot.latched):
            await self.robot.hold()
            await self.robot.release_latch()
        if self.stimulator is None:
            return []
        try:
            await self.stimulator.release_latch()
        except PcmrsError as error:
            log.warning("still_latched", device="stimulator", reason=error.text)
            return ["stimulator"]
        return []

    def motion_limits(self) -> MotionLimits:
        """The configured speed limits, within the arm's own."""
        motion, joints = self.settings.motion, len(self.arm.velocity)
        return MotionLimits(
            joint_velocity=tuple(motion.joint_speed_fraction * self.arm.velocity),
            joint_acceleration=(motion.joint_acceleration,) * joints,
            joint_jerk=(motion.joint_jerk,) * joints,
            linear_velocity=motion.linear_velocity,
            linear_acceleration=motion.linear_acceleration,
            linear_jerk=motion.linear_jerk,
            angular_velocity=motion.angular_velocity,
            angular_acceleration=motion.angular_acceleration,
        )

    def frames(self, data: PlacementData) -> FrameGraph:
        """The chain robot_base – flange – tool – coil – tracker – body_ref – image, with the arm at rest.

        Raises:
            RefusalError: Tool or body are not seen together, or the joints are not known.
        """
        count = self.settings.placement.frames
        tracked = self.poses.recent(["coil", "body_ref"], count, since=self.resting_since)
        graph = FrameGraph()
        graph.set(Frame.ROBOT_BASE, Frame.FLANGE, self.arm.forward(self.posture()))
        graph.set(Frame.FLANGE, Frame.TOOL, self.flange_from_tool)
        graph.set(Frame.TOOL, Frame.COIL, self.tool_from_coil)
        graph.set(Frame.TRACKER, Frame.COIL, tracked["coil"])
        graph.set(Frame.TRACKER, Frame.BODY_REF, tracked["body_ref"])
        if data.registered is not None:
            graph.set(Frame.BODY_REF, Frame.IMAGE, as_transform(data.registered.body_ref_from_image))
            self.remember_registered(data.registered)
        self.base_from_body_ref = graph.get(Frame.ROBOT_BASE, Frame.BODY_REF)
        self.base_from_tracker = graph.get(Frame.ROBOT_BASE, Frame.TRACKER)
        return graph

    def remember_registered(self, registered: Registered) -> None:
        """Takes the middle of the body, and where its image is, from a registration."""
        self.body_ref_from_image = as_transform(registered.body_ref_from_image)
        self.middle_in_body_ref = registered.middle_in_body_ref()

    def image_from_coil(self, data: PlacementData) -> Transform:
        """Where the tool is in the image: as the tracker sees it, or by the joints and where the body was last seen.

        Raises:
            RefusalError: There is no registration, or the body has never been seen.
        """
        try:
            return self.frames(data).get(Frame.IMAGE, Frame.COIL)
        except RefusalError:
            if data.registered is None or self.base_from_body_ref is None:
                raise
        base_from_image = self.base_from_body_ref @ as_transform(data.registered.body_ref_from_image)
        return base_from_image.inverse() @ self.arm.forward(self.posture()) @ self.flange_from_coil

    def flange_for(self, robot_base_from_coil: Transform) -> Transform:
        """``robot_base_from_flange`` that brings the coil to the pose."""
        return robot_base_from_coil @ self.flange_from_coil.inverse()


def calibration_id_of(settings: ProcedureSettings) -> str:
    """The `Cell.calibration_id` of a cell with these settings.

    Raises:
        ConfigurationError: A calibration file cannot be read.
    """
    files = settings.calibration
    return _identity(_calibration("tool", files.tool_file), _calibration("pointer", files.pointer_file), settings)


def _identity(tool: Calibration | None, pointer: Calibration | None, settings: ProcedureSettings) -> str:
    explicit = settings.calibration
    used = (
        tool.content_hash() if tool is not None else (explicit.flange_from_tool, explicit.tool_from_coil),
        pointer.content_hash() if pointer is not None else explicit.pointer_from_tip,
    )
    return hashlib.sha256(msgspec.json.encode(used)).hexdigest()[:16]


def _calibration(kind: Kind, file: str) -> Calibration | None:
    """The calibration in a configured file; None without one. Raises `ConfigurationError`."""
    if not file:
        return None
    key = f"procedure.calibration.{kind}_file"
    try:
        found = read_calibration(Path(file))
    except FileFormatError as error:
        raise ConfigurationError(f"{key}: {error.text}", **error.fields) from None
    if found.kind != kind:
        raise ConfigurationError(f"{key}: {file} is the calibration of a {found.kind}.", file=file)
    return found
