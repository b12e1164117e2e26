"""Locations of keys in one TOML file, or in several that are merged."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from copy import copy

import msgspec

from pcmrs.fsm.files._keys import TomlKey
from pcmrs.fsm.finding import Finding, Path

Spot = tuple[str, int, int]
"""Name of the file in findings; line and column, from 1."""


class Places:
    """File, line and column of every key.

    Args:
        text: Text of a file that `tomllib` can read.
        keys: All keys of the text.
        origin: Name of the file in findings.
    """

    def __init__(self, text: str, keys: Iterable[TomlKey], origin: str) -> None:
        self._origin = origin
        self._places: dict[Path, Spot] = {}
        lines = [0, *(match.end() for match in re.finditer("\n", text))]
        for key in keys:
            row = bisect_right(lines, key.at)
            spot = (origin, row, key.at - lines[row - 1] + 1)
            for length in range(len(key.above) + 1, len(key.path) + 1):  # and the tables that it creates implicitly
                self._places.setdefault(key.path[:length], spot)

    def of(self, path: Path) -> Spot:
        """Return the location of the key at `path`, or of the nearest key above it that is in the file."""
        while path and path not in self._places:
            path = path[:-1]
        return self._places.get(path, (self._origin, 1, 1))

    def over(self, base: Places, moved: Mapping[Path, Path]) -> Places:
        """Return the locations of the keys of this file, merged into those of another.

        Args:
            base: Locations of the other file.
            moved: Path of each list element of this file to its path in the merged lists.
        """
        taken = set(moved.values())
        others = base._places.items()  # of this class
        kept = {path: spot for path, spot in others if not taken.intersection(_up(path))}
        for path, spot in self._places.items():
            element = next((above for above in _up(path) if above in moved), ())
            kept[moved.get(element, ()) + path[len(element) :]] = spot
        both = copy(self)
        both._places = kept  # noqa: SLF001  # of this class
        return both


def with_locations(findings: Iterable[Finding], places: Places) -> list[Finding]:
    """Return the findings with file, line and column.

    Args:
        findings: Findings with the paths of their keys.
        places: Locations of the keys.
    """
    found = [(finding, *places.of(finding.path)) for finding in findings]
    return [msgspec.structs.replace(each, file=file, line=line, column=column) for each, file, line, column in found]


def _up(path: Path) -> Iterator[Path]:
    """The path and all above it."""
    return (path[:length] for length in range(len(path), 0, -1))
