"""Where in TOML files a key is: what the parser of the standard library does not tell."""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Iterator, Mapping
from copy import copy
from typing import Any

import msgspec
from tree_sitter import Node, Tree

from pcmrs.fsm.finding import Finding, Path

Spot = tuple[str, int, int]
"""File, as findings call it; line and column, from 1."""


class Places:
    """File, line and column of every key.

    Args:
        tree: The syntax of a file that `tomllib` can read.
        raw: The file.
        origin: How findings call it.
    """

    def __init__(self, tree: Tree, raw: bytes, origin: str) -> None:
        self._lines = raw.split(b"\n")
        self._origin = origin
        self._places: dict[Path, Spot] = {}
        self._lengths: dict[Path, int] = {}  # of arrays of tables
        for node in tree.root_node.named_children:
            self._take(node, ())

    def of(self, path: Path) -> Spot:
        """Where the key at `path` is, or the nearest above it that is in the file."""
        while path and path not in self._places:
            path = path[:-1]
        return self._places.get(path, (self._origin, 1, 1))

    def over(self, base: Places, moved: Mapping[Path, Path]) -> Places:
        """Where the keys of this file are, laid over those of another.

        Args:
            base: Of the other file.
            moved: Elements of lists of this file, to where they are among those of both.
        """
        both = copy(self)
        taken = set(moved.values())
        both._places = {path: spot for path, spot in base._places.items() if not taken.intersection(_up(path))}
        for path, spot in self._places.items():
            element = next((above for above in _up(path) if above in moved), ())
            both._places[moved.get(element, ()) + path[len(element) :]] = spot
        return both

    def _take(self, node: Node, above: Path) -> None:
        if node.type == "pair":
            key, value = node.named_children[:2]
            path = (*above, *_keys(key))
            self._note(key, path, above)
            self._take_value(value, path)
        elif node.type in ("table", "table_array_element"):
            key = node.named_children[0]
            path = self._resolved(_keys(key), new=node.type == "table_array_element")
            self._note(key, path, ())
            for child in node.named_children[1:]:
                self._take(child, path)

    def _take_value(self, node: Node, path: Path) -> None:
        if node.type == "inline_table":
            for child in node.named_children:
                self._take(child, path)
        elif node.type == "array":
            for index, child in enumerate(item for item in node.named_children if item.type != "comment"):
                self._note(child, (*path, str(index)), path)
                self._take_value(child, (*path, str(index)))

    def _note(self, node: Node, path: Path, above: Path) -> None:
        """Remembers where `path` is, and the tables on the way to it from `above`."""
        row, byte = node.start_point
        column = len(self._lines[row][:byte].decode(errors="replace"))
        for length in range(len(above) + 1, len(path) + 1):
            self._places.setdefault(path[:length], (self._origin, row + 1, column + 1))

    def _resolved(self, keys: Path, *, new: bool) -> Path:
        """The path of a header, with the number of the newest element after each array of tables."""
        path: Path = ()
        for key in keys[:-1]:
            path = (*path, key)
            if path in self._lengths:
                path = (*path, str(self._lengths[path] - 1))
        path = (*path, keys[-1])
        if not new:
            return path
        self._lengths[path] = self._lengths.get(path, 0) + 1
        return (*path, str(self._lengths[path] - 1))


def placed(findings: Iterable[Finding], places: Places) -> list[Finding]:
    """The findings with file, line and column."""
    found = [(finding, *places.of(finding.path)) for finding in findings]
    return [msgspec.structs.replace(each, file=file, line=line, column=column) for each, file, line, column in found]


def _up(path: Path) -> Iterator[Path]:
    """The path and all above it."""
    return (path[:length] for length in range(len(path), 0, -1))


def _keys(node: Node) -> Path:
    text = (node.text or b"").decode()
    return tuple(_flat(tomllib.loads(f"{text} = 0")))


def _flat(table: dict[str, Any]) -> Iterator[str]:
    for key, inner in table.items():
        yield key
        if isinstance(inner, dict):
            yield from _flat(inner)
