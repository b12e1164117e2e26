"""The cell as operations see it: devices, calibrations, and the present poses."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from dataclasses import InitVar, dataclass, field

import numpy as np
import structlog

from pcmrs.calibration import KINDS
from pcmrs.clock import Clock
from pcmrs.devices.poses import PoseFeed
from pcmrs.devices.protocols import Emg, LatchingRobot, LatchingStimulator, Pointer
from pcmrs.errors import PcmrsError, RefusalError
from pcmrs.formats.mesh import Mesh
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointState
from pcmrs.spatial import Floats, Frame, FrameGraph, Transform
from pcmrs.workflows.data import PlacementData, Registered, as_transform
from pcmrs.workflows.mounting import Mounting
from pcmrs.workflows.settings import ProcedureSettings
from pcmrs.workflows.teleop_port import TeleopPort
from pcmrs.workflows.zones import CellZones

__all__ = ["Cell"]

log = structlog.get_logger(__name__)


def _no_beep(_count: int) -> None:
    """Sound nothing."""


@dataclass
class Cell:
    """Devices and calibrations of one cell.

    Attributes:
        robot: Robot that carries the tool.
        pointer: Pointer with which a person touches points.
        poses: Newest tracked poses.
        arm: Model of the robot's arm.
        clock: Clock of the cell.
        settings: Settings of the procedure.
        surface: Surface of the body in the image; None if none is configured. It is read once when the cell is opened,
            so that planning, guard and display use the same surface even if the file has changed since.
        joints: Newest measured joints; None until the robot has reported them.
        resting_since: Time at which the arm came to rest, s of the clock. Poses captured earlier show it moving.
        base_from_body_ref: Last seen pose of the body in the robot's base.
        base_from_tracker: Pose of the tracker in the robot's base at that time.
        body_ref_from_image: Last registration in force, even if it has been given up.
        middle_in_body_ref: Centre of the last registered landmarks in body_ref, m, (3,). It remains when the
            registration is given up, because its place in the body does not change. None until a registration.
        earlier_body_ref_from_image: Last accepted registration of an earlier run, while there has been none since and
            it still fits. The arm keeps away from the body at that place.
        initial_joints: Posture to which `placement.to_initial` returns, rad, (n,); None for the home posture.
        watchers: Functions that receive every newly measured joint state.
        name: ``site/name`` of the cell.
        uses_robot: True if the workflow connects or moves the robot. Otherwise nobody has ever released the arm, if
            there is one: it has been latched since its start, and neither Stop nor its release waits for it.
        stimulator: Stimulator; None if none is configured.
        emg: Electromyograph; None if none is configured.
        teleop: Port for the set points of teleoperators.
        point_to_point: True if the arm moves in segments and can be stopped only at the end of one. It then cannot
            press, follow the body or be guided.
        beep: Sounds a number of beeps for the person with the pointer, without waiting; nothing by default.
        calibrated: Calibrated poses of tool and pointer, for a cell in another process; None to read them.
        mounting: Calibrated poses of tool and pointer. `Mounting.tool_tip` is the only place where the pose of a marker
            body becomes that of the tool: all other poses of the tool in the workflows are those of its contact point.
        flange_from_tool_tip: Pose of the tool's contact point on the flange.
        zones: Zones that the arm keeps out of.
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
    point_to_point: bool = False
    beep: Callable[[int], None] = _no_beep
    calibrated: InitVar[Mounting | None] = None
    mounting: Mounting = field(init=False)
    flange_from_tool_tip: Transform = field(init=False)
    zones: CellZones = field(init=False)

    def __post_init__(self, calibrated: Mounting | None) -> None:
        self.mounting = calibrated or Mounting.read(self.settings.calibration)
        self.flange_from_tool_tip = self.mounting.flange_from_tool_tip
        self.zones = CellZones(self.arm.facts, self.mounting, self.settings, self.surface)

    @property
    def pointer_from_tip(self) -> Transform:
        """Pose of the tip in the pointer's marker body."""
        return self.mounting.pointer_from_tip

    @property
    def calibration_id(self) -> str:
        """Short hash of the calibrations in use. Registrations with another hash are not comparable."""
        return self.mounting.identity

    def calibrations(self) -> dict[str, str]:
        """Return the title of each calibration file in use, or ``explicit`` for poses of the configuration."""
        files = self.mounting.files
        return {kind: files[kind].title() if kind in files else "explicit" for kind in KINDS}

    def posture(self) -> Floats:
        """Return the measured joints at rest, rad, (n,).

        Raises:
            RefusalError: The robot has not reported its joints yet.
        """
        if self.joints is None:
            raise RefusalError("joints_unknown", "The robot has not reported its joints yet: connect it first.")
        return np.array(self.joints.positions)

    @property
    def home(self) -> tuple[float, ...]:
        """Home posture as configured, or the arm's own, rad, base to flange."""
        return self.settings.home or self.arm.facts.home

    def update_joints(self, state: JointState) -> None:
        """Take a newly measured joint state."""
        if state.moving:
            # Each state of a moving arm postpones the rest, because earlier poses show the arm in motion.
            self.resting_since = self.clock.monotonic()
        self.joints = state
        # A copy, because a watcher may be removed meanwhile.
        for watch in tuple(self.watchers):
            watch(state)

    async def make_safe(self, latch: bool) -> None:
        """Hold the robot, if the workflow uses it, and disarm the stimulator, both at once.

        Args:
            latch: True if both must not act again before a release; False if only a motion is ended.

        Raises:
            PcmrsError: One of them has not confirmed.
        """
        robot, stimulator = self.robot, self.stimulator
        requests: list[Awaitable[object]] = []
        if self.uses_robot:
            requests.append(robot.stop() if latch else robot.hold())
        if stimulator is not None:
            requests.append(stimulator.stop() if latch else stimulator.disarm())
        # Both requests must end before a failure is raised: the failure of one device must not leave the other one
        # unsafe.
        for answer in await asyncio.gather(*requests, return_exceptions=True):
            if isinstance(answer, BaseException):
                raise answer

    async def release(self, stopped: bool) -> list[str]:
        """Release the latch of robot and stimulator, after the robot has confirmed that it stands still, if it is used.

        Args:
            stopped: True if robot and stimulator were stopped. Otherwise a robot that is not latched is left alone: it
                may be moving, and an acknowledgement that arrives too late must not hold it.

        Returns:
            Names of the devices that stay latched. A stimulator that does not answer must not prevent a retreat.

        Raises:
            DeviceError: The robot moves, was held again meanwhile, or refuses.
            UnknownOutcomeError: The robot does not answer.
        """
        if self.uses_robot and (stopped or self.robot.latched):
            # The robot confirms its standstill before the latch is released.
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

    def check_streams(self, what: str) -> None:
        """Refuse an action for which the arm must react while it moves.

        Args:
            what: The action, as the end of a sentence: what the arm cannot do.

        Raises:
            RefusalError: ``point_to_point``.
        """
        if self.point_to_point:
            text = (
                f'The arm cannot {what}: with kst.motion = "ptp" the cabinet moves it in segments, and takes no '
                'command until a segment has ended. With the controller\'s servo option, set kst.motion = "servo".'
            )
            raise RefusalError("point_to_point", text)

    def motion_limits(self) -> MotionLimits:
        """Return the configured speed limits, within the arm's own limits."""
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
        """Return the frames from the robot's base over the tool to tracker, reference and image, with the arm at rest.

        Raises:
            RefusalError: Tool and body are not seen together, or the joints are not known.
        """
        count = self.settings.placement.frames
        # Earlier frames show the arm elsewhere than the joints.
        tracked = self.poses.recent(["coil", "body_ref"], count, since=self.resting_since)
        graph = FrameGraph()
        graph.set(Frame.ROBOT_BASE, Frame.FLANGE, self.arm.forward(self.posture()))
        graph.set(Frame.FLANGE, Frame.TOOL_TIP, self.flange_from_tool_tip)
        graph.set(Frame.TRACKER, Frame.TOOL_TIP, self.mounting.tool_tip(tracked["coil"]))
        graph.set(Frame.TRACKER, Frame.REFERENCE, tracked["body_ref"])
        if data.registered is not None:
            graph.set(Frame.REFERENCE, Frame.IMAGE, as_transform(data.registered.body_ref_from_image))
            self.remember_registered(data.registered)
        self.base_from_body_ref = graph.get(Frame.ROBOT_BASE, Frame.REFERENCE)
        self.base_from_tracker = graph.get(Frame.ROBOT_BASE, Frame.TRACKER)
        return graph

    def remember_registered(self, registered: Registered) -> None:
        """Store the middle of the body and the pose of its image from a registration."""
        self.body_ref_from_image = as_transform(registered.body_ref_from_image)
        self.middle_in_body_ref = registered.middle_in_body_ref()

    def image_from_tool_tip(self, data: PlacementData) -> Transform:
        """Return the pose of the tool in the image.

        It is measured by the tracker, or computed from the joints and the last seen pose of the body.

        Raises:
            RefusalError: There is no registration, or the body has never been seen.
        """
        try:
            return self.frames(data).get(Frame.IMAGE, Frame.TOOL_TIP)
        except RefusalError:
            if data.registered is None or self.base_from_body_ref is None:
                raise
        base_from_image = self.base_from_body_ref @ as_transform(data.registered.body_ref_from_image)
        return base_from_image.inverse() @ self.arm.forward(self.posture()) @ self.flange_from_tool_tip

    def flange_for(self, robot_base_from_tool_tip: Transform) -> Transform:
        """Return the ``robot_base_from_flange`` that brings the tool's contact point to a pose."""
        return robot_base_from_tool_tip @ self.flange_from_tool_tip.inverse()


def calibration_id_of(settings: ProcedureSettings) -> str:
    """Return the `Cell.calibration_id` of a cell with these settings.

    Raises:
        ConfigurationError: A calibration file cannot be read.
    """
    return Mounting.read(settings.calibration).identity
