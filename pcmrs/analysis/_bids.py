"""Tables and sidecars of the Brain Imaging Data Structure (BIDS 1.10, "Common principles", tabular files).

Columns are separated by tabs, missing values are ``n/a``, truth values are ``true`` and ``false``, and each column is
described in a JSON file of the same name.
"""

from __future__ import annotations

import gzip
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import msgspec

R = TypeVar("R")

MISSING = "n/a"
VERSION = "1.10.0"
DIGITS = 7
"""Significant digits of written numbers: more than any measurement here has."""


@dataclass(frozen=True)
class Column(Generic[R]):
    """One column of a table.

    Attributes:
        name: Name in snake case.
        description: Description for people.
        value: Returns the value of a row; None if it is missing.
        units: Unit of its numbers; empty for text.
        levels: Meaning of its words.
    """

    name: str
    description: str
    value: Callable[[R], Any]
    units: str = ""
    levels: Mapping[str, str] | None = None

    def described(self) -> dict[str, Any]:
        """Return its entry in the sidecar."""
        entry: dict[str, Any] = {"Description": self.description}
        if self.units:
            entry["Units"] = self.units
        if self.levels:
            entry["Levels"] = dict(self.levels)
        return entry


def write_ignored(dataset: Path, pattern: str) -> None:
    """Write the file ``.bidsignore``, so that validators skip files that are not part of BIDS yet.

    Args:
        dataset: Folder of the dataset; it is created.
        pattern: Files that are not part of BIDS, in the syntax of ``.gitignore``.
    """
    dataset.mkdir(parents=True, exist_ok=True)
    (dataset / ".bidsignore").write_text(f"{pattern}\n")


def write_table(path: Path, columns: Sequence[Column[R]], rows: Iterable[R], **fields: Any) -> None:
    """Write a table and its sidecar, whose name ends in ``.json`` instead.

    Args:
        path: File of the table, ending in ``.tsv``, or ``.tsv.gz`` to compress it; its folder is created.
        columns: Columns, in order.
        rows: Rows, in order.
        fields: Fields of the sidecar before its columns.
    """
    lines = ["\t".join(column.name for column in columns)]
    lines += ["\t".join(cell(column.value(row)) for column in columns) for row in rows]
    text = ("\n".join(lines) + "\n").encode()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(text, mtime=0) if path.suffix == ".gz" else text)
    sidecar = path.with_name(path.name.removesuffix(".gz").removesuffix(".tsv") + ".json")
    write_json(sidecar, fields | {column.name: column.described() for column in columns})


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a sidecar, or another JSON file.

    Args:
        path: File; its folder is created.
        content: Keys and values.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(msgspec.json.format(msgspec.json.encode(content), indent=2) + b"\n")


def cell(value: Any) -> str:
    """Return a value as the text of a table cell: numbers without noise in their last digits, text on one line."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return MISSING
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}"
    return " ".join(str(value).split()) or MISSING


def label(text: str) -> str:
    """Return the letters and digits of a name, for the name of a file."""
    return re.sub(r"[^A-Za-z0-9]", "", text) or "unknown"
