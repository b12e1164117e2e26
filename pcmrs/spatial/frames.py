"""The coordinate frames of a cell."""

from __future__ import annotations

from enum import StrEnum


class Frame(StrEnum):
    """Right-handed frames, in metres.

    Attributes:
        WORLD: Fixed to the room.
        ROBOT_BASE: Foot of the arm, +z along its first axis.
        FLANGE: Mounting face of the last link, +z out of the face.
        TOOL: What the flange carries; +z points away from the body.
        COIL: The tracked marker body on the tool.
        TRACKER: The camera of the optical tracker.
        BODY_REF: The marker body fixed to the patient.
        POINTER: The marker body of the digitizing pointer.
        POINTER_TIP: The tip of that pointer.
        IMAGE: The patient's medical image; RAS: +x right, +y anterior, +z superior.
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
