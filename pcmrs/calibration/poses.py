"""Files of poses for calibration: CSV with a header, or JSON with the same names.

A pose ``a_from_b`` has the columns ``a_from_b_x_mm, …_y_mm, …_z_mm, …_qx, …_qy, …_qz, …_qw``; ``_m`` in place of
``_mm`` for metres. All poses of a row were taken at one time.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pcmrs.errors import GeometryError
from pcmrs.formats.grid import METRES
from pcmrs.formats.reading import read_table, read_text, refuse
from pcmrs.spatial import Floats, Transform

__all__ = [
    "HAND_EYE",
    "PIVOT",
    "POINT",
    "TIP_PIVOT",
    "TOUCHED",
    "Touches",
    "header",
    "read_poses",
    "read_touches",
    "write_poses",
]

PIVOT = ("tracker_from_pointer",)
"""Poses in each row of a file for a pivot calibration."""
TIP_PIVOT = ("tracker_from_tool_marker",)
"""Poses in each row of a file for a pivot calibration of a tool."""
TOUCHED = ("tracker_from_tool_marker", "tracker_from_pointer")
"""Poses in each row of a file of touched points of a tool."""
POINT = "point_in_tool_tip"
"""Known point that a row of such a file touches. Without it, the row touches any point of the tool's surface."""
HAND_EYE = ("base_from_flange", "tracker_from_tool_marker")
"""Poses in each row of a file for a hand-eye calibration."""

MAX_TOOL = 1.0
"""Farthest distance of a point of a tool from its contact point, m. A larger number was probably given in mm."""
MAX_DISTANCE = 20.0
"""Farthest distance from the tracker, m. No tracker sees farther: a larger number was probably given in mm."""


def read_poses(path: Path, names: Sequence[str]) -> list[list[Transform]]:
    """Return the poses in a file.

    Args:
        path: File to read: JSON if its name ends in ``.json``, otherwise CSV.
        names: Names of the poses that every row must have, such as `PIVOT`. Other columns are ignored.

    Returns:
        For each name one pose per row.

    Raises:
        FileFormatError: The file cannot be read, a column or its unit is missing, or a row holds an invalid pose.
    """
    rows = _rows(path, names)
    return [[_pose(path, number, row, name) for number, row in enumerate(rows, start=1)] for name in names]


@dataclass(frozen=True, eq=False)
class Touches:
    """Points of a tool that a pointer has touched.

    Attributes:
        known_in_tool_tip: Known points in the frame of the tool's contact point, m, (N, 3).
        known_in_tool_marker: The same points as they were touched, in the tool's marker body, m, (N, 3).
        surface_in_tool_marker: Points touched anywhere on the surface, in the tool's marker body, m, (K, 3).
    """

    known_in_tool_tip: Floats
    known_in_tool_marker: Floats
    surface_in_tool_marker: Floats


def read_touches(path: Path, tip_in_pointer: Floats) -> Touches:
    """Return the touched points in a file.

    Args:
        path: File to read, with the poses `TOUCHED` and the columns of `POINT`, which are empty for a point of the
            surface: JSON if its name ends in ``.json``, otherwise CSV.
        tip_in_pointer: Tip of the pointer in its marker body, m, (3,).

    Raises:
        FileFormatError: The file cannot be read, a column or its unit is missing, or a row holds an invalid pose or
            point.
    """
    known: list[Floats] = []
    touched: tuple[list[Floats], list[Floats]] = [], []
    for number, row in enumerate(_rows(path, TOUCHED), start=1):
        marker, pointer = (_pose(path, number, row, name) for name in TOUCHED)
        point = _point(path, number, row)
        known += [] if point is None else [point]
        touched[point is None].append(marker.inverse() @ (pointer @ tip_in_pointer))
    at_known, at_surface = (np.array(points).reshape(-1, 3) for points in touched)
    return Touches(np.array(known).reshape(-1, 3), at_known, at_surface)


def _rows(path: Path, names: Sequence[str]) -> Sequence[Mapping[str, Any]]:
    rows = _from_json(path) if path.suffix == ".json" else [row for _, row in read_table(path)[1]]
    if not rows:
        refuse(path, f"holds no poses; the first line must be a header such as {header(names)}.")
    return rows


def header(names: Sequence[str], unit: str = "m") -> str:
    """Return the header of a CSV file with these poses.

    Args:
        names: Names of the poses.
        unit: Unit of the positions: ``m`` or ``mm``.
    """
    return ",".join(column for name in names for column in _columns(name, unit))


def write_poses(path: Path, names: Sequence[str], poses: Sequence[Sequence[Transform]]) -> None:
    """Write a CSV file that `read_poses` reads, with positions in m.

    Args:
        path: File to write.
        names: Names of the poses.
        poses: For each name one pose per row; all of one length.

    Raises:
        OSError: The file cannot be written.
    """
    rows = [
        # Nine digits are 1 nm in 1 m, far below the noise of any tracker.
        ",".join(f"{value:.9g}" for pose in row for value in (*pose.translation, *pose.quat_xyzw))
        for row in zip(*poses, strict=True)
    ]
    path.write_text("\n".join([header(names), *rows]) + "\n")


def _columns(name: str, unit: str) -> list[str]:
    return [*(f"{name}_{axis}_{unit}" for axis in "xyz"), *(f"{name}_q{axis}" for axis in "xyzw")]


def _from_json(path: Path) -> Sequence[Mapping[str, Any]]:
    try:
        rows = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        refuse(path, f"is not JSON: {error}.")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        refuse(path, "is not a JSON list of objects, one for each time.")
    return rows


def _point(path: Path, number: int, row: Mapping[str, Any]) -> Floats | None:
    """Return the known point of a row, m, (3,); None if there is none. Raises `FileFormatError`."""
    for unit in ("m", "mm"):
        values = [row.get(f"{POINT}_{axis}_{unit}", "") for axis in "xyz"]
        if all(value in ("", None) for value in values):
            continue
        try:
            point = METRES[unit] * np.array([float(value) for value in values])
        except (TypeError, ValueError, OverflowError) as error:
            refuse(path, f"holds no point {POINT} in row {number}: {str(error).rstrip('.')}.", row=number)
        if not np.isfinite(point).all():
            refuse(path, f"holds a point {POINT} in row {number} that is not finite.", row=number)
        if (farthest := float(abs(point).max())) > MAX_TOOL:
            refuse(path, f"has {POINT} {farthest:g} m away in row {number}: is it in mm?", row=number, value=farthest)
        return point
    return None


def _pose(path: Path, number: int, row: Mapping[str, Any], name: str) -> Transform:
    """Return the pose `name` of a row. Raises `FileFormatError`."""
    unit = next((unit for unit in ("m", "mm") if set(_columns(name, unit)) <= set(row)), None)
    if unit is None:
        refuse(
            path, f"has no pose {name} in row {number}; its columns are {header([name])}, or _mm for _m.", row=number
        )
    try:
        numbers = [float(row[column]) for column in _columns(name, unit)]
        pose = Transform.from_quat_xyzw([value * METRES[unit] for value in numbers[:3]], numbers[3:])
    except (TypeError, ValueError, OverflowError, GeometryError) as error:
        refuse(path, f"holds no pose {name} in row {number}: {str(error).rstrip('.')}.", row=number)
    if abs(pose.translation).max() > MAX_DISTANCE:
        farthest = float(abs(pose.translation).max())
        refuse(path, f"has {name} {farthest:g} m away in row {number}: is the file in mm?", row=number, value=farthest)
    return pose
