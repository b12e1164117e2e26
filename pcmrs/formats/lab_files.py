"""The lab's folder of YAML files: which there are, where each is, and the data of a procedure in them."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from pcmrs.errors import FileFormatError
from pcmrs.formats.lab_text import Point, lab_cloud, lab_digitized, lab_planned, lab_registration, lab_tool_pose
from pcmrs.formats.lab_yaml import read_lab_cloud, read_lab_landmarks, read_lab_pose, read_refined
from pcmrs.formats.reading import MAX_TEXT_BYTES, read_bytes, refuse
from pcmrs.spatial import Transform

LANDMARKS, DIGITIZED, REGISTRATION = "landmarkplan.yaml", "landmarkdig.yaml", "reg.yaml"
TOOL_POSE, CLOUD = "toolpose.yaml", "icpdig.yaml"
PROCEDURE = (LANDMARKS, DIGITIZED, REGISTRATION, TOOL_POSE, CLOUD)
"""Files of a procedure."""
CALIBRATIONS = ("tool_toolref.yaml", "toolref_eff.yaml", "ptr_ptrtip.yaml", "offset_tool.yaml", "cntct_offset.yaml")
"""Files of the calibrations; ``a_b.yaml`` holds ``a_from_b``."""
MANY_ENTRIES = 200_000
"""Limit of the entries of a folder and its folders: more is not the software of a lab."""


@dataclass(frozen=True, eq=False)
class LabProcedure:
    """Data of a procedure, as the lab's files hold them; missing values are empty or None.

    Attributes:
        planned: Planned landmarks in the image, m, in their order.
        digitized: Digitized landmarks in body_ref, m, in the same order; None for one that is not digitized.
        registration: ``body_ref_from_image``.
        refined: A surface was used for the registration.
        tool_pose: Planned ``image_from_tool_tip``.
        surface: Points touched on the surface, in body_ref, m.
    """

    planned: tuple[Point, ...] = ()
    digitized: tuple[Point | None, ...] = ()
    registration: Transform | None = None
    refined: bool = False
    tool_pose: Transform | None = None
    surface: tuple[Point, ...] = ()


def procedure_texts(procedure: LabProcedure, when: datetime) -> dict[str, str]:
    """Return the texts of the files of a procedure, by their names; there is none for missing values.

    Args:
        procedure: The data.
        when: Local time of the plan of the landmarks.
    """
    found = {}
    if procedure.planned:
        found[LANDMARKS] = lab_planned(procedure.planned, when)
    if procedure.digitized:
        found[DIGITIZED] = lab_digitized(procedure.digitized)
    if procedure.surface:
        found[CLOUD] = lab_cloud(procedure.surface)
    if procedure.registration is not None:
        found[REGISTRATION] = lab_registration(procedure.registration, refined=procedure.refined)
    if procedure.tool_pose is not None:
        found[TOOL_POSE] = lab_tool_pose(procedure.tool_pose)
    return found


def find_lab_files(folder: Path, wanted: Collection[str]) -> dict[str, Path]:
    """Return the place of each wanted file in a folder or its folders, such as a checkout of the lab's software.

    Copies with other names, such as ``reg_20230731_020032PM.yaml``, do not count.

    Args:
        folder: The folder. Links in it are not followed.
        wanted: Names of the files.

    Raises:
        FileFormatError: It is no folder, has too many entries, or has a file twice with different content.
    """
    if not folder.is_dir():
        refuse(folder, "is not a folder: give the folder of the lab's YAML files, or one above it.")
    found: dict[str, list[Path]] = {}
    entries = 0
    for place, folders, names in os.walk(folder):
        folders.sort()
        entries += len(folders) + len(names)
        if entries > MANY_ENTRIES:
            text = f"has more than {MANY_ENTRIES} entries: give the folder of the lab's YAML files."
            refuse(folder, text, limit=MANY_ENTRIES)
        for name in sorted(set(wanted).intersection(names)):
            found.setdefault(name, []).append(Path(place) / name)
    return {name: _only(paths) for name, paths in found.items()}


def read_lab_procedure(found: Mapping[str, Path]) -> LabProcedure:
    """Return the data of a procedure in the lab's files.

    Args:
        found: Place of each file that there is, by its name.

    Raises:
        FileFormatError: A file cannot be read, or the landmarks of plan and digitization are not those of each other.
    """
    planned = _landmarks(found, LANDMARKS)
    digitized = _landmarks(found, DIGITIZED)
    if planned and digitized and len(planned) != len(digitized):
        text = (
            f"holds {len(digitized)} landmarks, but {found[LANDMARKS]} holds {len(planned)}: they are of two plans. "
            "Give files of one session, or leave the procedure out."
        )
        refuse(found[DIGITIZED], text, digitized=len(digitized), planned=len(planned))
    registration = found.get(REGISTRATION)
    tool_pose = found.get(TOOL_POSE)
    cloud = found.get(CLOUD)
    return LabProcedure(
        planned,
        digitized,
        None if registration is None else read_lab_pose(registration),
        registration is not None and read_refined(registration),
        None if tool_pose is None else read_lab_pose(tool_pose),
        () if cloud is None else tuple(read_lab_cloud(cloud)),
    )


def _only(paths: list[Path]) -> Path:
    """Return the one place of a file; copies with the same content count as one."""
    contents = {read_bytes(path, MAX_TEXT_BYTES) for path in paths} if len(paths) > 1 else set()
    if len(contents) > 1:
        places = ", ".join(map(str, paths))
        text = (
            f"{paths[0].name} is there {len(paths)} times with different content, so it is not clear which is meant: "
            f"{places}. Give a folder with one of them."
        )
        raise FileFormatError(text, files=[str(path) for path in paths])
    return paths[0]


def _landmarks(found: Mapping[str, Path], name: str) -> tuple[Point, ...]:
    """Return the landmarks of a file, if it is there.

    The lab's software writes zeros, and PCMRS not a number, for a landmark that is not digitized.
    """
    path = found.get(name)
    if path is None:
        return ()
    points, role = read_lab_landmarks(path)
    wanted = "planned" if name == LANDMARKS else "digitized"
    if role != wanted:
        refuse(path, f"holds {role} landmarks, not {wanted} ones: it was saved under a wrong name.", role=role)
    for label, point in points:
        if not all(abs(value) < float("inf") for value in point) or point == (0.0, 0.0, 0.0):
            text = f"has no point for landmark {label}: {point}. Digitize it, or leave the procedure out."
            refuse(path, text, name=label)
    return tuple((x, y, z) for _, (x, y, z) in points)
