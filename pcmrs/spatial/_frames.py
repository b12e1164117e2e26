"""Coordinate frames of a cell."""

from __future__ import annotations

from enum import StrEnum


class Frame(StrEnum):
    """Right-handed coordinate frames, in metres.

    Attributes:
        WORLD: Frame fixed to the room.
        ROBOT_BASE: Foot of the arm, with +z along the first joint axis.
        FLANGE: Mounting face of the last link, with +z out of the face.
        TOOL: Tool on the flange, with +z away from the body.
        COIL: Tracked marker body on the tool.
        TRACKER: Camera of the optical tracker.
        BODY_REF: Marker body fixed to the patient.
        POINTER: Marker body of the digitizing pointer.
        POINTER_TIP: Tip of the digitizing pointer.
        IMAGE: The patient's medical image in RAS: +x right, +y anterior, +z superior.
    """

    WORLD = "world"
    ROBOT_BASE = "robot_base"
    FLANGE = "flange"
    TOOL = "tool"
    COIL = "coil"
    TRACKER = "tracker"
    BODY_REF = "body_ref"
    POINTER = "pointer"
    POINTER_TIP = "pointer_tip"
    IMAGE = "image"
