"""The frames of a cell as one tree, from what is on the bus and what was calibrated.

The tracker is the root: it sees the marker bodies. The arm hangs from it by `robot_base`, worked out whenever the arm
stands and the tracker sees the coil; both are fixed in the room, so this stays true while the coil is hidden. A frame
has one parent only, so where the joints say that the coil is has a name of its own, `COIL_BY_ROBOT`.
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

Link = tuple[str, str, Transform]
"""Parent, child and ``parent_from_child``."""


@dataclass(frozen=True, slots=True)
class Mounting:
    """What was calibrated.

    Attributes:
        flange_from_tool: The mount on the flange.
        flange_from_coil: The tracked body on it.
        pointer_from_tip: The tip in the pointer's marker body.
    """

    flange_from_tool: Transform
    flange_from_coil: Transform
    pointer_from_tip: Transform

    @classmethod
    def read(cls, calibration: CalibrationSettings) -> Mounting:
        """From calibration files where they are configured, else from the configured poses.

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

    def links(self) -> list[Link]:
        """What never moves."""
        tool_from_coil = self.flange_from_tool.inverse() @ self.flange_from_coil
        return [
            (Frame.FLANGE, Frame.TOOL, self.flange_from_tool),
            (Frame.TOOL, COIL_BY_ROBOT, tool_from_coil),
            (Frame.POINTER, Frame.POINTER_TIP, self.pointer_from_tip),
        ]


class FrameTree:
    """Joins the arm to the tracker.

    Args:
        arm: The arm's facts.
        mounting: What it carries.
    """

    def __init__(self, arm: ArmFacts, mounting: Mounting) -> None:
        self._arm = ArmModel(arm)
        self._mounting = mounting
        self._base_from_flange: Transform | None = None
        self._moving = True

    def joints(self, state: JointState) -> Link:
        """Where the flange is, by measured joints.

        Raises:
            GeometryError: There are not as many joints as the arm has, or one is not finite.
        """
        self._base_from_flange = self._arm.forward(state.positions)
        self._moving = state.moving
        return Frame.ROBOT_BASE, Frame.FLANGE, self._base_from_flange

    def coil(self, tracker_from_coil: Transform) -> Link | None:
        """Where the arm's base is, by the coil that the tracker sees; None while the arm moves or is not known."""
        if self._base_from_flange is None or self._moving:
            return None
        base_from_coil = self._base_from_flange @ self._mounting.flange_from_coil
        return Frame.TRACKER, Frame.ROBOT_BASE, tracker_from_coil @ base_from_coil.inverse()
