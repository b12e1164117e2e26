"""Landmarks of any file that PCMRS reads, and the pairing of planned with digitized ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from pcmrs.errors import GeometryError
from pcmrs.formats._points_csv import read_points_csv
from pcmrs.formats._slicer_markups import read_fcsv, read_markups
from pcmrs.formats.grid import Named, Role, Unit
from pcmrs.formats.lab_yaml import read_lab_landmarks
from pcmrs.formats.reading import read_text, refuse
from pcmrs.spatial import Floats

__all__ = ["Landmarks", "Pairs", "pair_landmarks", "read_landmarks"]


class _Landmark(msgspec.Struct, frozen=True):
    name: str
    position: tuple[float, float, float]


class _Plan(msgspec.Struct, frozen=True):
    landmarks: tuple[_Landmark, ...]


def _read_plan_landmarks(path: Path) -> tuple[list[Named], Role]:
    """Return the planned landmarks in the image, RAS, m.

    Raises:
        FileFormatError: It is not a plan.
    """
    try:
        plan = msgspec.json.decode(read_text(path), type=_Plan)
    except (msgspec.MsgspecError, RecursionError) as error:
        refuse(path, f"is not a plan: {error}.")
    return [(landmark.name, landmark.position) for landmark in plan.landmarks], "planned"


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Named points.

    Attributes:
        names: Unique names, in the order of the file.
        points: Points in the frame of the file, converted to RAS if it is LPS, m, (N, 3).
        role: Planned or digitized, if the file says so.
    """

    names: tuple[str, ...]
    points: Floats
    role: Role | None = None


@dataclass(frozen=True, eq=False)
class Pairs:
    """Planned and digitized landmarks, row by row.

    Attributes:
        names: Names in the plan.
        planned: Points in the image, m, (N, 3).
        digitized: Points in body_ref, m, (N, 3).
        matched_by: ``name``, or ``order`` if the files name their points differently.
    """

    names: tuple[str, ...]
    planned: Floats
    digitized: Floats
    matched_by: Literal["name", "order"]


SUFFIXES = (".yaml", ".yml", ".mrk.json", ".json", ".fcsv", ".csv")


def read_landmarks(path: Path, csv_unit: Unit | None = None) -> Landmarks:
    """Return the landmarks of a file, by its suffix: YAML of the lab, 3D Slicer's markups, a plan of PCMRS, or CSV.

    Args:
        path: The file.
        csv_unit: Unit of a CSV file whose columns do not name it.

    Raises:
        FileFormatError: It cannot be read, its suffix is unknown, or it does not hold named, finite points.
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
            return _read_plan_landmarks(path)
        case [*_, ".fcsv"]:
            return read_fcsv(path), None
        case [*_, ".csv"]:
            return read_points_csv(path, csv_unit), None
    refuse(path, f"has none of the known suffixes: {', '.join(SUFFIXES)}.")


def _landmarks(path: Path, found: Sequence[Named], role: Role | None) -> Landmarks:
    names = tuple(name for name, _ in found)
    if not names:
        refuse(path, "holds no landmarks.")
    for index, (name, point) in enumerate(found):
        if not name:
            refuse(path, f"has no name for its point {index + 1}; name every landmark.", index=index)
        if name in names[:index]:
            refuse(path, f"names two landmarks {name}; give each its own name.", name=name)
        if not np.isfinite(point).all():
            refuse(path, f"has no point for landmark {name}: {point}; digitize it.", name=name)
    return Landmarks(names, np.array([point for _, point in found], dtype=float), role)


def pair_landmarks(planned: Landmarks, digitized: Landmarks) -> Pairs:
    """Pair landmarks by name if both files have the same names, else by order.

    Args:
        planned: Landmarks of the plan.
        digitized: Landmarks measured on the body.

    Raises:
        GeometryError: One of them has the role of the other, their numbers differ, or a name that both have is at
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
                "the digitization, and other names differ: the pairs are ambiguous; use the same names in both.",
                name=name,
            )
    return Pairs(planned.names, planned.points, digitized.points, "order")


def _check_role(landmarks: Landmarks, wanted: Role) -> None:
    """Refuse landmarks that are given for the other role.

    Exchanged landmarks would give the inverse transform, with the same residuals.
    """
    if landmarks.role not in (None, wanted):
        text = (
            f"The file for the {wanted} landmarks says that they are {landmarks.role}; give plan and digitization in "
            "this order."
        )
        raise GeometryError(text, wanted=wanted, role=landmarks.role)
