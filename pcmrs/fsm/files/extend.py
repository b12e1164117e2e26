"""Merges a blueprint into the file beside it that it extends."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path as FilePath
from typing import Any

from pcmrs.fsm.files._keys import rename_keys
from pcmrs.fsm.files.places import Places, with_locations
from pcmrs.fsm.files.toml import read_bounded, read_toml
from pcmrs.fsm.finding import Finding, Path, refuse

EXTENDS = "extends"
OWN = ("id", "version", "title", "goal", "stage", "migrations")
"""Keys that identify a workflow: never taken from the file that it extends."""

FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}\.toml")

Table = dict[str, Any]


def read_layers(raw: bytes, origin: str, folder: FilePath | None) -> tuple[Table, Places, list[Finding]]:
    """Return the table of a blueprint file, merged into that of the file which it extends.

    Tables merge. Properties replace those of the same `id` and are else appended, revocations are appended, and
    anything else replaces what was there.

    Args:
        raw: The file.
        origin: Name of the file in findings.
        folder: Folder of the file; None if it has none.

    Returns:
        The merged table, where each of its keys comes from, and warnings of keys that have an old name.

    Raises:
        BlueprintError: One of the two files cannot be read, or cannot be extended; `findings` has where.
    """
    own, places, warnings = _read_layer(raw, origin)
    if EXTENDS not in own:
        return own, places, warnings
    base, below, older = _read_base(own.pop(EXTENDS), places, folder)
    moved: dict[Path, Path] = {}
    merged = _merged(base, own, (), moved)
    return merged, places.over(below, moved), [*older, *warnings]


def extended_file(path: FilePath) -> FilePath | None:
    """Return the file that a blueprint extends; None if it extends none.

    Raises:
        OSError: The blueprint cannot be opened.
        BlueprintError: It cannot be read, or what it extends is not the name of a file beside it.
    """
    own, places = read_toml(read_bounded(path), str(path))
    return path.parent / _base_name(own[EXTENDS], places) if EXTENDS in own else None


def _read_layer(raw: bytes, origin: str) -> tuple[Table, Places, list[Finding]]:
    table, places = read_toml(raw, origin)
    return table, places, with_locations(rename_keys(table), places)


def _read_base(name: object, places: Places, folder: FilePath | None) -> tuple[Table, Places, list[Finding]]:
    name = _base_name(name, places)
    origin, line, column = places.of((EXTENDS,))
    here = line, column
    if folder is None:
        text = f"`extends` names {name}, but this text has no folder: give the path of its file."
        refuse(origin, "bad_extends", text, here, (EXTENDS,))
    # FILE_NAME has no separator: a blueprint cannot read files outside of its folder.
    path = folder / name
    try:
        if not path.is_file():
            refuse(
                origin,
                "bad_extends",
                f"`extends` names {name}, but there is no such file beside this one.",
                here,
                (EXTENDS,),
            )
        raw = read_bounded(path)
    except OSError as error:
        text = f"`extends` names {name}, which cannot be read: {error.strerror}."
        refuse(origin, "bad_extends", text, here, (EXTENDS,))
    base, below, warnings = _read_layer(raw, str(FilePath(origin).with_name(name)))
    # One level only, so that a reviewer reads at most two files, and no chain can be endless.
    if EXTENDS in base:
        text = f"`extends` names {name}, which extends another file itself: extend that one, or write it whole."
        refuse(origin, "bad_extends", text, here, (EXTENDS,))
    return {key: value for key, value in base.items() if key not in OWN}, below, warnings


def _base_name(name: object, places: Places) -> str:
    origin, line, column = places.of((EXTENDS,))
    if not (isinstance(name, str) and FILE_NAME.fullmatch(name)):
        text = f"`extends` is {name!r}; it must be the name of a .toml file beside this one, without a folder."
        refuse(origin, "bad_extends", text, (line, column), (EXTENDS,))
    return name


def _merged(base: Mapping[str, Any], own: Mapping[str, Any], above: Path, moved: dict[Path, Path]) -> Table:
    """Return `own` merged into `base`, and note in `moved` the new position of each list element."""
    merged = dict(base)
    for key, value in own.items():
        path, below = (*above, key), merged.get(key)
        if isinstance(below, dict) and isinstance(value, dict):
            merged[key] = _merged(below, value, path, moved)
        elif isinstance(below, list) and isinstance(value, list) and _is_extended(path):
            merged[key] = _merged_list(below, value, path, moved)
        else:
            merged[key] = value
    return merged


def _is_extended(path: Path) -> bool:
    return path == ("properties",) or (path[0] == "branches" and path[2:] == ("revocations",))


def _merged_list(below: list[Any], own: list[Any], path: Path, moved: dict[Path, Path]) -> list[Any]:
    """Return both lists; an element replaces the one below that has its `id`."""
    numbers = {element["id"]: index for index, element in enumerate(below) if _identified(element)}
    result = list(below)
    for index, element in enumerate(own):
        number = numbers.get(element["id"], len(result)) if _identified(element) else len(result)
        result[number : number + 1] = [element]
        moved[(*path, str(index))] = (*path, str(number))
    return result


def _identified(element: object) -> bool:
    return isinstance(element, dict) and isinstance(element.get("id"), str)
