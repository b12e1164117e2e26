"""The frames of a cell as one tree, from messages on the bus and from calibrations.

The tracker is the root: it sees the marker bodies. `robot_base` links the arm to it; it is computed whenever the arm
stands still and the tracker sees the tool. Both are fixed in the room, so it stays valid while the tool is hidden. A
frame has one parent only, so the pose of the tool's marker body by the joints has its own frame, `COIL_BY_ROBOT`.
"""

from __future__ import annotations

from typing import Final

from pcmrs.kinematics.arms import ArmFacts
from pcmrs.kinematics.model import ArmModel
from pcmrs.messages import JointState
from pcmrs.spatial import Frame, Transform
from pcmrs.workflows.mounting import Mounting

COIL_BY_ROBOT: Final = "coil_by_robot"

FrameLink = tuple[str, str, Transform]
"""Parent, child and ``parent_from_child``."""


def fixed_links(mounting: Mounting) -> list[FrameLink]:
    """Return the links that never move.

    Args:
        mounting: Calibrated poses of tool and pointer.
    """
    return [
        (Frame.FLANGE, COIL_BY_ROBOT, mounting.flange_from_tool_marker),
        (Frame.TOOL_MARKER, Frame.TOOL_TIP, mounting.tool_marker_from_tool_tip),
        (Frame.POINTER_MARKER, Frame.POINTER_TIP, mounting.pointer_from_tip),
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

    def tool(self, tracker_from_tool_marker: Transform) -> FrameLink | None:
        """Return the pose of the robot's base in the tracker frame; None while the arm moves or its joints are unknown.

        Args:
            tracker_from_tool_marker: Measured pose of the tool's marker body in the tracker frame.
        """
        if self._base_from_flange is None or self._moving:
            return None
        base_from_tool_marker = self._base_from_flange @ self._mounting.flange_from_tool_marker
        return Frame.TRACKER, Frame.ROBOT_BASE, tracker_from_tool_marker @ base_from_tool_marker.inverse()
