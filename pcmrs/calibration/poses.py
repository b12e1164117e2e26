"""Files of poses for calibration: CSV with a header, or JSON with the same names.

A pose ``a_from_b`` has the columns ``a_from_b_x_mm, …_y_mm, …_z_mm, …_qx, …_qy, …_qz, …_qw``; ``_m`` in place of
``_mm`` for metres. All poses of a row were taken at one time.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pcmrs.errors import GeometryError
from pcmrs.formats.grid import METRES
from pcmrs.formats.reading import read_table, read_text, refuse
from pcmrs.spatial import Transform

__all__ = ["HAND_EYE", "PIVOT", "header", "read_poses", "write_poses"]

PIVOT = ("tracker_from_pointer",)
"""Poses in each row of a file for a pivot calibration."""
HAND_EYE = ("base_from_flange", "tracker_from_coil")
"""Poses in each row of a file for a hand-eye calibration."""

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
    rows = _from_json(path) if path.suffix == ".json" else [row for _, row in read_table(path)[1]]
    if not rows:
        refuse(path, f"holds no poses; the first line must be a header such as {header(names)}.")
    return [[_pose(path, number, row, name) for number, row in enumerate(rows, start=1)] for name in names]


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
