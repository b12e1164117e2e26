"""Saved placements: one YAML file per trial with the planned and the measured pose of the tool.

The lab's software and the gateway write them: ``PLANNED_POSE`` and ``MEASURED_POSE``, each with a
``TRANSLATION`` x y z in m and a ``ROTATION`` quaternion x y z w, in flow style with comments.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from pcmrs.errors import FileFormatError
from pcmrs.formats.lab_yaml import lab_pose
from pcmrs.formats.reading import YamlFile, read_yaml, refuse
from pcmrs.spatial import Transform

__all__ = ["Placement", "read_placements"]

SUFFIXES = (".yaml", ".yml")


@dataclass(frozen=True, eq=False, slots=True)
class Placement:
    """A planned pose of the tool, and the pose that the tracker measured.

    Attributes:
        name: Name of the trial: the file's name without suffix, or the row of a journal.
        planned: ``image_from_tool`` as planned; +z of the tool points away from the body.
        measured: ``image_from_tool`` as measured.
    """

    name: str
    planned: Transform
    measured: Transform


def read_placements(path: Path) -> list[Placement]:
    """Read a saved placement, or all of a folder in the order of their names, numbers in them by value.

    Raises:
        FileFormatError: There are none, or some cannot be read; the text names each of these with its reason.
    """
    paths = _files_of(path) if path.is_dir() else [path]
    placements, refused = [], []
    for file in paths:
        try:
            placements.append(_read(file))
        except FileFormatError as error:
            refused.append(error)
    if refused:
        files = [error.fields["file"] for error in refused]
        raise FileFormatError(" ".join(error.text for error in refused), files=files)
    return placements


def _files_of(folder: Path) -> list[Path]:
    files = sorted((file for file in folder.iterdir() if file.suffix in SUFFIXES), key=_by_number)
    if not files:
        refuse(folder, "holds no saved placement (*.yaml): name the folder of the trials.")
    return files


def _read(path: Path) -> Placement:
    content = read_yaml(path)
    return Placement(path.stem, _pose(content, "PLANNED_POSE"), _pose(content, "MEASURED_POSE"))


def _pose(content: YamlFile, key: str) -> Transform:
    if not isinstance(content.keys.get(key), dict):
        refuse(content.path, f"is not a saved placement: it holds no pose under {key}.", key=key)
    return lab_pose(content, key)


def _by_number(path: Path) -> list[str | int]:
    """Return a sort key that puts trial_2 before trial_10. Texts and numbers alternate, so they are never compared."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"([0-9]+)", path.name)]
