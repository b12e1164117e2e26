"""Frames of the lab's software: its calibrations as those of PCMRS, and the reverse.

rotms-ros places its tool by ``bodyref_body body_cntct cntct_offset offset_tool tool_toolref toolref_eff``, where
``a_b`` is the pose of b in a. There ``cntct`` is the plan, ``cntct_offset`` the standoff, ``toolref`` the tracked
marker body, and ``eff`` the flange. At the plan, with no standoff, ``offset`` coincides with ``cntct``. So ``offset``
is the frame that a plan places: the tool tip of PCMRS.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pcmrs.errors import FileFormatError
from pcmrs.formats.lab_yaml import read_lab_calibration
from pcmrs.spatial import Transform, rotation_angle

TOOL_MARKER, FLANGE, POINTER = "tool_toolref.yaml", "toolref_eff.yaml", "ptr_ptrtip.yaml"
OFFSET_TOOL, STANDOFF = "offset_tool.yaml", "cntct_offset.yaml"
AMBIGUOUS: Final = (TOOL_MARKER, FLANGE, POINTER)
"""Files in which the identity may be a placeholder as well as a calibration."""
SIDEWAYS = 1e-4
"""Largest part of a standoff that is not along the axis of the tool, m and rad: the decimals of a file."""
SAME = 1e-9
"""Difference from the identity below which a pose is the identity, m and rad."""


@dataclass(frozen=True, eq=False)
class LabCalibrations:
    """Calibrations of a tool and a pointer in the frames of PCMRS.

    Attributes:
        flange_from_tool_marker: Pose of the tool's marker body on the flange.
        tool_marker_from_tool_tip: Contact point and axes of the tool in its marker body.
        pointer_from_tip: Pose of the tip in the pointer's marker body.
        standoff: Distance along the tool's +z axis at which an approach ends, m.
    """

    flange_from_tool_marker: Transform
    tool_marker_from_tool_tip: Transform
    pointer_from_tip: Transform
    standoff: float


def read_lab_calibrations(found: Mapping[str, Path], identities: tuple[str, ...] = ()) -> LabCalibrations:
    """Read the calibration files of the lab's software.

    Args:
        found: Place of each file, by its name.
        identities: Names of the files in which the identity is meant.

    Raises:
        FileFormatError: A file is missing or cannot be read, holds the identity, or they do not fit each other.
    """
    wanted = (*AMBIGUOUS, OFFSET_TOOL, STANDOFF)
    missing = [name for name in wanted if name not in found]
    if missing:
        text = f"{', '.join(missing)} is not there: the tool is known only by all of {', '.join(wanted)}. Add it."
        raise FileFormatError(text, missing=missing)
    poses = {name: read_lab_calibration(found[name]) for name in wanted}
    for name in AMBIGUOUS:
        if _is_identity(poses[name]) and name not in identities:
            text = (
                f"{found[name]} in line 1 holds the identity, which may be a placeholder: calibrate, or say that it is "
                f"meant with --identity-in {name}."
            )
            raise FileFormatError(text, file=str(found[name]), line=1)
    lab_tool_from_tool_tip = poses[OFFSET_TOOL].inverse()
    tool_marker_from_lab_tool = poses[TOOL_MARKER].inverse()
    tool_marker_from_tool_tip = tool_marker_from_lab_tool @ lab_tool_from_tool_tip
    flange_from_tool_marker = poses[FLANGE].inverse()
    tool_tip_from_flange = (flange_from_tool_marker @ tool_marker_from_tool_tip).inverse()
    _check_axis(found, tool_tip_from_flange)
    standoff = _standoff(found[STANDOFF], poses[STANDOFF])
    return LabCalibrations(flange_from_tool_marker, tool_marker_from_tool_tip, poses[POINTER], standoff)


def lab_calibrations_of(calibrations: LabCalibrations) -> dict[str, Transform]:
    """Return the poses of the lab's files, by the names of the files.

    Args:
        calibrations: Calibrations in the frames of PCMRS.
    """
    tool_tip_from_tool_marker = calibrations.tool_marker_from_tool_tip.inverse()
    return {
        TOOL_MARKER: tool_tip_from_tool_marker,
        FLANGE: calibrations.flange_from_tool_marker.inverse(),
        POINTER: calibrations.pointer_from_tip,
        OFFSET_TOOL: Transform.identity(),
        STANDOFF: Transform.from_rotvec((0.0, 0.0, calibrations.standoff), (0.0, 0.0, 0.0)),
    }


def _check_axis(found: Mapping[str, Path], tool_tip_from_flange: Transform) -> None:
    """Refuse a tool whose +z axis points from the arm to the body: its files are inverse, or of two tools.

    Raises:
        FileFormatError: The flange is not on the side of +z of the contact point.
    """
    height = float(tool_tip_from_flange.translation[2])
    if height <= 0.0:
        text = (
            f"{found[TOOL_MARKER]} and {found[FLANGE]} do not fit each other: in the frame of the contact point the "
            f"flange is at z = {height * 1000.0:.1f} mm, but +z must point away from the body, to the arm. a_b.yaml "
            "must hold the pose of b in a, and both files must be of the mounted tool."
        )
        raise FileFormatError(text, files=[str(found[TOOL_MARKER]), str(found[FLANGE])], height=height)


def _standoff(path: Path, contact_from_offset: Transform) -> float:
    x, y, z = contact_from_offset.translation.tolist()
    turn = rotation_angle(contact_from_offset, Transform.identity())
    if math.hypot(x, y) > SIDEWAYS or turn > SIDEWAYS or z <= 0.0:
        text = (
            f"{path} in line 1 holds the offset {x * 1000.0:.1f} {y * 1000.0:.1f} {z * 1000.0:.1f} mm, turned by "
            f"{math.degrees(turn):.2f}°: an approach ends on the axis of the tool, at positive z. Write 0 0 z and no "
            "rotation, and plan the rest of the pose."
        )
        raise FileFormatError(text, file=str(path), line=1)
    return float(z)


def _is_identity(pose: Transform) -> bool:
    return rotation_angle(pose, Transform.identity()) < SAME and math.hypot(*pose.translation) < SAME
