"""Coordinate frames of a cell."""

from __future__ import annotations

from enum import StrEnum


class Frame(StrEnum):
    """Right-handed coordinate frames, in metres.

    The value of a frame is its name on the bus and in recordings: the three marker bodies have there the names under
    which the tracker publishes them.

    Attributes:
        WORLD: Frame fixed to the room.
        ROBOT_BASE: Foot of the arm, with +z along the first joint axis.
        FLANGE: Mounting face of the last link, with +z out of the face.
        TOOL_MARKER: Tracked marker body on the tool.
        TOOL_TIP: Contact point and axes of the tool, which a plan places on the body; +z points away from the body.
        TRACKER: Camera of the optical tracker.
        REFERENCE: Marker body fixed to the patient.
        POINTER_MARKER: Marker body of the digitizing pointer.
        POINTER_TIP: Tip of the digitizing pointer.
        IMAGE: The patient's medical image in RAS: +x right, +y anterior, +z superior.
    """

    WORLD = "world"
    ROBOT_BASE = "robot_base"
    FLANGE = "flange"
    TOOL_MARKER = "coil"
    TOOL_TIP = "tool_tip"
    TRACKER = "tracker"
    REFERENCE = "body_ref"
    POINTER_MARKER = "pointer"
    POINTER_TIP = "pointer_tip"
    IMAGE = "image"
