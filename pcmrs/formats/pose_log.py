"""Pose logs of a tracker: CSV rows ``name,x,y,z,qx,qy,qz,qw``, three for each sample, lengths in m.

The lab's software and the gateway write them. A sample is the rows `ROWS` in their order; a row whose name
does not come after that of the row before begins the next sample, so a missing row leaves a gap in its own sample only.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pcmrs.errors import GeometryError
from pcmrs.formats.reading import read_bytes, refuse
from pcmrs.spatial import Transform

__all__ = ["PoseLog", "read_pose_log"]

ROWS = ("body_tool", "pol_body", "pol_tool")
"""``image_from_tool``, ``tracker_from_image``, ``tracker_from_tool``: the body of the lab's software is the image."""

MAX_BYTES = 20 * 1024 * 1024
"""Limit of a file: more than an hour at 20 samples per second."""


@dataclass(frozen=True, eq=False, slots=True)
class PoseLog:
    """Poses that a tracker measured, sample by sample.

    Attributes:
        name: The file's name without suffix.
        poses: For each name of `ROWS`, one pose per sample; None if its row is missing.
    """

    name: str
    poses: dict[str, list[Transform | None]]

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.poses[ROWS[0]])


def read_pose_log(path: Path) -> PoseLog:
    """Read a pose log.

    Raises:
        FileFormatError: It cannot be read, has no rows, or a row is not a pose; the text names file and line.
    """
    poses: dict[str, list[Transform | None]] = {name: [] for name in ROWS}
    previous = len(ROWS)
    for name, pose in _rows(path):
        if ROWS.index(name) <= previous:
            for series in poses.values():
                series.append(None)
        previous = ROWS.index(name)
        poses[name][-1] = pose
    if not poses[ROWS[0]]:
        refuse(path, "is an empty pose log.")
    return PoseLog(path.stem, poses)


def _rows(path: Path) -> Iterator[tuple[str, Transform]]:
    try:
        lines = read_bytes(path, MAX_BYTES).decode("utf-8-sig").splitlines()
        for line, cells in enumerate(csv.reader(lines), start=1):
            if cells:
                yield _row(path, line, [cell.strip() for cell in cells])
    except (csv.Error, UnicodeDecodeError) as error:
        refuse(path, f"is not CSV: {error}.")


def _row(path: Path, line: int, cells: list[str]) -> tuple[str, Transform]:
    name, *values = cells
    if name not in ROWS or len(values) != 7:
        refuse(
            path, f"holds no row NAME,x,y,z,qx,qy,qz,qw in line {line}; NAME is one of {', '.join(ROWS)}.", line=line
        )
    try:
        numbers = [float(value) for value in values]
        return name, Transform.from_quat_xyzw(numbers[:3], numbers[3:])
    except (ValueError, GeometryError) as error:
        refuse(path, f"holds no pose in line {line}, {name}: {str(error).rstrip('.')}.", line=line)
