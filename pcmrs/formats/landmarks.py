"""Landmarks of any file that PCMRS reads, and which of two files belong together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from pcmrs.errors import GeometryError
from pcmrs.formats.grid import Named, Role, Unit
from pcmrs.formats.lab_yaml import read_lab_landmarks
from pcmrs.formats.plan_json import read_plan_landmarks
from pcmrs.formats.points_csv import read_points_csv
from pcmrs.formats.reading import refuse
from pcmrs.formats.slicer_markups import read_fcsv, read_markups
from pcmrs.spatial import Floats


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Named points.

    Attributes:
        names: Different from one another, in the order of the file.
        points: In the frame of the file, turned to RAS where it says LPS, m, (N, 3).
        role: What they are, where the file says so.
    """

    names: tuple[str, ...]
    points: Floats
    role: Role | None = None


@dataclass(frozen=True, eq=False)
class Pairs:
    """Planned and digitized landmarks, row by row.

    Attributes:
        names: As they are planned.
        planned: In the image, m, (N, 3).
        digitized: In body_ref, m, (N, 3).
        matched_by: ``name``, or ``order`` where the files name their points differently.
    """

    names: tuple[str, ...]
    planned: Floats
    digitized: Floats
    matched_by: Literal["name", "order"]


ENDINGS = (".yaml", ".yml", ".mrk.json", ".json", ".fcsv", ".csv")


def read_landmarks(path: Path, csv_unit: Unit | None = None) -> Landmarks:
    """The landmarks of a file, by its ending: YAML of the lab, 3D Slicer's markups, a plan of PCMRS, or CSV.

    Args:
        path: The file.
        csv_unit: Unit of a CSV file whose columns do not name theirs.

    Raises:
        FileFormatError: It cannot be read, its ending is unknown, or it does not hold named, finite points.
    """
    found, role = _read(path, csv_unit)
    return _landmarks(path, found, role)


def _read(path: Path, csv_unit: Unit | None) -> tuple[list[Named], Role | None]:
    match [suffix.lower() for suffix in path.suffixes]:
        case [*_, ".yaml" | ".yml"]:
            return read_lab_landmarks(path)
        case [*_, ".mrk", ".json"]:
            return read_markups(path), None
        case [*_, ".json"]:
            return read_plan_landmarks(path)
        case [*_, ".fcsv"]:
            return read_fcsv(path), None
        case [*_, ".csv"]:
            return read_points_csv(path, csv_unit), None
    refuse(path, f"has none of the known endings: {', '.join(ENDINGS)}.")


def _landmarks(path: Path, found: Sequence[Named], role: Role | None) -> Landmarks:
    names = tuple(name for name, _ in found)
    if not names:
        refuse(path, "holds no landmarks.")
    for index, (name, point) in enumerate(found):
        if not name:
            refuse(path, f"has no name for its point {index + 1}; name every landmark.", index=index)
        if name in names[:index]:
            refuse(path, f"names two landmarks {name}; give each a name of its own.", name=name)
        if not np.isfinite(point).all():
            refuse(path, f"has no point for landmark {name}: {point}; digitize it.", name=name)
    return Landmarks(names, np.array([point for _, point in found], dtype=float), role)


def pair_landmarks(planned: Landmarks, digitized: Landmarks) -> Pairs:
    """Bring landmarks together by name where both have the same names, else by order.

    Raises:
        GeometryError: One of them says that it is the other, their numbers differ, or a name that both have stands at
            different places.
    """
    _check_role(planned, "planned")
    _check_role(digitized, "digitized")
    if len(planned.names) != len(digitized.names):
        raise GeometryError(
            f"There are {len(planned.names)} planned landmarks but {len(digitized.names)} digitized ones; "
            "give a digitization of this plan.",
            planned=list(planned.names),
            digitized=list(digitized.names),
        )
    if set(planned.names) == set(digitized.names):
        order = [digitized.names.index(name) for name in planned.names]
        return Pairs(planned.names, planned.points, digitized.points[order], "name")
    for index, name in enumerate(planned.names):
        if name in digitized.names and digitized.names[index] != name:
            raise GeometryError(
                f"Landmark {name} is number {index + 1} of the plan but number {digitized.names.index(name) + 1} of "
                "the digitization, and other names differ: nobody can say which belong together; name both alike.",
                name=name,
            )
    return Pairs(planned.names, planned.points, digitized.points, "order")


def _check_role(landmarks: Landmarks, wanted: Role) -> None:
    """Exchanged, they would give the inverse transform, with the same residuals."""
    if landmarks.role not in (None, wanted):
        text = (
            f"The landmarks to be the {wanted} ones say that they are {landmarks.role}; give plan and digitization in "
            "this order."
        )
        raise GeometryError(text, wanted=wanted, role=landmarks.role)
