"""The frames of a cell as one tree, from messages on the bus and from calibrations.

The tracker is the root: it sees the marker bodies. `robot_base` links the arm to it; it is computed whenever the arm
stands still and the tracker sees the coil. Both are fixed in the room, so it stays valid while the coil is hidden. A
frame has one parent only, so the pose of the coil by the joints has its own frame, `COIL_BY_ROBOT`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pcmrs.calibration import read_calibration
from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointState
from pcmrs.spatial import Frame, Transform
from pcmrs.workflows.settings import CalibrationSettings

COIL_BY_ROBOT: Final = "coil_by_robot"

FrameLink = tuple[str, str, Transform]
"""Parent, child and ``parent_from_child``."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """Calibrated poses of the tool and the pointer.

    Attributes:
        flange_from_tool: Pose of the mount in the flange frame.
        flange_from_coil: Pose of the tracked body of the coil in the flange frame.
        pointer_from_tip: Pose of the tip in the frame of the pointer's marker body.
    """

    flange_from_tool: Transform
    flange_from_coil: Transform
    pointer_from_tip: Transform

    @classmethod
    def read(cls, calibration: CalibrationSettings) -> Mounting:
        """Read the calibration files that are configured, and take the configured poses otherwise.

        Raises:
            FileFormatError: A calibration file cannot be read.
        """
        flange_from_tool = calibration.flange_from_tool.transform()
        flange_from_coil = flange_from_tool @ calibration.tool_from_coil.transform()
        pointer_from_tip = calibration.pointer_from_tip.transform()
        if calibration.tool_file:
            flange_from_coil = read_calibration(Path(calibration.tool_file)).transform()
        if calibration.pointer_file:
            pointer_from_tip = read_calibration(Path(calibration.pointer_file)).transform()
        return cls(flange_from_tool, flange_from_coil, pointer_from_tip)

    def links(self) -> list[FrameLink]:
        """Return the links that never move."""
        tool_from_coil = self.flange_from_tool.inverse() @ self.flange_from_coil
        return [
            (Frame.FLANGE, Frame.TOOL, self.flange_from_tool),
            (Frame.TOOL, COIL_BY_ROBOT, tool_from_coil),
            (Frame.POINTER, Frame.POINTER_TIP, self.pointer_from_tip),
        ]


class FrameTree:
    """The moving links of arm and tracker.

    Args:
        arm: Facts of the arm.
        mounting: Poses of what it carries.
    """

    def __init__(self, arm: ArmFacts, mounting: Mounting) -> None:
        self._arm = ArmModel(arm)
        self._mounting = mounting
        self._base_from_flange: Transform | None = None
        self._positions: list[float] = []
        self._moving = True

    def joints(self, state: JointState) -> FrameLink:
        """Return the pose of the flange in the robot's base frame, from measured joints.

        Raises:
            GeometryError: The number of joints differs from the arm's, or a value is not finite.
        """
        if self._base_from_flange is None or state.positions != self._positions:
            self._base_from_flange = self._arm.forward(state.positions)
            self._positions = state.positions
        self._moving = state.moving
        return Frame.ROBOT_BASE, Frame.FLANGE, self._base_from_flange

    def coil(self, tracker_from_coil: Transform) -> FrameLink | None:
        """Return the pose of the robot's base in the tracker frame; None while the arm moves or its joints are unknown.

        Args:
            tracker_from_coil: Measured pose of the coil in the tracker frame.
        """
        if self._base_from_flange is None or self._moving:
            return None
        base_from_coil = self._base_from_flange @ self._mounting.flange_from_coil
        return Frame.TRACKER, Frame.ROBOT_BASE, tracker_from_coil @ base_from_coil.inverse()
