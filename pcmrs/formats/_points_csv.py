"""Named points in a CSV file with a header: ``name`` (or ``label``) and ``x_mm,y_mm,z_mm`` or ``x_m,y_m,z_m``, RAS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from pcmrs.formats.grid import Named, Unit, as_ras
from pcmrs.formats.reading import read_table, refuse

EXAMPLE = "name,x_mm,y_mm,z_mm"


def read_points_csv(path: Path, unit: Unit | None = None) -> list[Named]:
    """Return the points of a file, RAS, m; other columns are ignored.

    Args:
        path: The file.
        unit: Unit of columns called x, y, z; if the columns name a unit, it must be the same.

    Raises:
        FileFormatError: It has no header, a column twice, no unit, two units, or a row that is not a point.
    """
    header, rows = read_table(path)
    if not header:
        refuse(path, f"is empty; it must begin with a header such as {EXAMPLE}.")
    found = _unit(path, header, unit)
    axes = [axis if axis in header else f"{axis}_{found}" for axis in "xyz"]
    name = "name" if "name" in header else "label"
    return [_point(path, line, row, (name, *axes), found) for line, row in rows]


def _unit(path: Path, header: Sequence[str], given: Unit | None) -> Unit:
    if "name" not in header and "label" not in header:
        refuse(path, f"has no column name or label in its first line; begin with a header such as {EXAMPLE}.")
    named: list[Unit] = [unit for unit in ("m", "mm") if {f"{axis}_{unit}" for axis in "xyz"} <= set(header)]
    plain = {"x", "y", "z"} <= set(header)
    if len(named) + plain != 1:
        refuse(path, f"needs its coordinates in three columns, once; begin with a header such as {EXAMPLE}.")
    if named and given not in (None, named[0]):
        refuse(path, f"has columns in {named[0]}, but {given} was asked for.", unit=named[0])
    unit = named[0] if named else given
    if unit is None:
        refuse(path, "does not declare the unit of its columns x, y, z; call them x_mm or x_m, and y and z likewise.")
    return unit


def _point(path: Path, line: int, row: Mapping[str, str], columns: Sequence[str], unit: Unit) -> Named:
    try:
        name, *point = (row[column] for column in columns)
        return name, tuple(as_ras([float(value) for value in point], unit, "RAS").tolist())
    except (KeyError, ValueError):
        refuse(path, f"holds no name with three numbers in row {line}: {','.join(row.values())}.", row=line)
