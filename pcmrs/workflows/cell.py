"""The cell as operations see it: devices, calibrations, and where everything is now."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field

import msgspec
import numpy as np

from pcmrs.clock import Clock
from pcmrs.devices.poses import PoseFeed
from pcmrs.devices.protocols import Pointer, Robot
from pcmrs.errors import RefusalError
from pcmrs.kinematics.limits import MotionLimits
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointState
from pcmrs.spatial import Floats, Frame, FrameGraph, Transform
from pcmrs.workflows.data import PlacementData, Registered, as_transform
from pcmrs.workflows.settings import ProcedureSettings


@dataclass
class Cell:
    """Devices and calibrations of one cell.

    Attributes:
        joints: Newest measured joints; None until the robot has been heard.
        resting_since: When the arm came to rest, s of the clock; poses captured earlier show it moving.
        initial_joints: Posture that `placement.to_initial` returns to; the home posture until one is remembered.
        base_from_body_ref: Where the body was last seen in the robot's base.
        middle_in_body_ref: Centre of the landmarks that were registered last, m, (3,): it stays where it is in the
            body when the registration is given up. None until this cell has seen a registration.
    """

    robot: Robot
    pointer: Pointer
    poses: PoseFeed
    arm: ArmModel
    clock: Clock
    settings: ProcedureSettings
    joints: JointState | None = None
    resting_since: float = -math.inf
    base_from_body_ref: Transform | None = None
    middle_in_body_ref: Floats | None = None
    initial_joints: list[float] | None = None
    flange_from_coil: Transform = field(init=False)
    pointer_from_tip: Transform = field(init=False)

    def __post_init__(self) -> None:
        calibration = self.settings.calibration
        self.flange_from_tool = calibration.flange_from_tool.transform()
        self.tool_from_coil = calibration.tool_from_coil.transform()
        self.flange_from_coil = self.flange_from_tool @ self.tool_from_coil
        self.pointer_from_tip = calibration.pointer_from_tip.transform()

    @property
    def calibration_id(self) -> str:
        """Short hash of the calibrations: what was registered with another one is not comparable."""
        return hashlib.sha256(msgspec.json.encode(self.settings.calibration)).hexdigest()[:16]

    def posture(self) -> Floats:
        """Measured joints at rest, rad, (7,).

        Raises:
            RefusalError: The robot has not been heard yet.
        """
        if self.joints is None:
            raise RefusalError("joints_unknown", "The robot has not reported its joints yet: connect it first.")
        return np.array(self.joints.positions)

    def update_joints(self, state: JointState) -> None:
        """Takes a newly measured joint state."""
        if state.moving:
            self.resting_since = self.clock.monotonic()
        self.joints = state

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
            self.remember_middle(data.registered)
        self.base_from_body_ref = graph.get(Frame.ROBOT_BASE, Frame.BODY_REF)
        return graph

    def remember_middle(self, registered: Registered) -> None:
        """Takes the middle of the body from a registration."""
        centre: Floats = np.mean([landmark.position for landmark in registered.landmarks], axis=0)
        self.middle_in_body_ref = as_transform(registered.body_ref_from_image) @ centre

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
