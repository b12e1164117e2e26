"""Point lists of 3D Slicer: markups (``.mrk.json``) and the older ``.fcsv``, in the directions that they declare.

https://slicer.readthedocs.io/en/latest/developer_guide/modules/markups.html
"""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Literal

import msgspec

from pcmrs.formats.grid import Named, as_ras
from pcmrs.formats.reading import read_text, refuse

FCSV_SPACES = {"RAS": "RAS", "LPS": "LPS", "0": "RAS", "1": "LPS"}
"""Slicer wrote numbers until 4.10."""


class _ControlPoint(msgspec.Struct, frozen=True, rename="camel"):
    position: tuple[float, float, float]
    label: str = ""
    position_status: str = "defined"


class _Markup(msgspec.Struct, frozen=True, rename="camel"):
    coordinate_system: Literal["LPS", "RAS"]
    control_points: tuple[_ControlPoint, ...]
    type: str = "Fiducial"
    coordinate_units: Literal["mm", "um", "m"] = "mm"


class _Markups(msgspec.Struct, frozen=True):
    markups: tuple[_Markup, ...]


def read_markups(path: Path) -> list[Named]:
    """Return the points of a ``.mrk.json`` file, RAS, m.

    Raises:
        FileFormatError: It is not such a file, does not declare LPS or RAS, has an unknown unit, several lists, another
            kind of markup, or a point that is not placed.
    """
    try:
        markups = msgspec.json.decode(read_text(path), type=_Markups).markups
    except (msgspec.MsgspecError, RecursionError) as error:
        refuse(path, f"is not a point list of 3D Slicer: {error}.")
    if len(markups) != 1 or markups[0].type != "Fiducial":
        kinds = ", ".join(markup.type for markup in markups) or "nothing"
        refuse(path, f"holds {kinds}; it must hold one point list (Fiducial): save that list alone.", kinds=kinds)
    return [_named(path, point, markups[0]) for point in markups[0].control_points]


def _named(path: Path, point: _ControlPoint, markup: _Markup) -> Named:
    if point.position_status != "defined":
        refuse(path, f"has the point {point.label} as {point.position_status}; place it in 3D Slicer.")
    ras = as_ras(point.position, markup.coordinate_units, markup.coordinate_system)
    return point.label, tuple(ras.tolist())


def read_fcsv(path: Path) -> list[Named]:
    """Return the points of an ``.fcsv`` file, which are in mm there, as RAS and m.

    Raises:
        FileFormatError: It does not declare its directions or its columns, is not CSV, or a row does not fit them.
    """
    lines = read_text(path).splitlines()
    declared = dict(line[1:].split("=", 1) for line in lines if line.startswith("#") and "=" in line)
    header = {key.strip(): value.strip() for key, value in declared.items()}
    space = FCSV_SPACES.get(header.get("CoordinateSystem", ""))
    if space is None:
        refuse(path, "does not declare its CoordinateSystem as LPS or RAS in a comment line.")
    columns = [column.strip() for column in header.get("columns", "").split(",")]
    if not {"x", "y", "z", "label"} <= set(columns):
        refuse(path, "does not declare its columns, among them x, y, z and label, in a comment line.")
    try:
        rows = list(csv.reader(line for line in lines if line.strip() and not line.startswith("#")))
    except csv.Error as error:
        refuse(path, f"is not CSV: {error}.")
    return [_fcsv_point(path, number, dict(zip(columns, row, strict=False)), space) for number, row in enumerate(rows)]


def _fcsv_point(path: Path, number: int, row: dict[str, str], space: str) -> Named:
    try:
        point = [float(row[axis]) for axis in "xyz"]
        return row["label"].strip(), tuple(as_ras(point, "mm", space).tolist())
    except (KeyError, ValueError):
        refuse(path, f"has a row that does not fit its columns: point {number + 1}, {row}.", row=number)
