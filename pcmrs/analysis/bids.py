"""Tables and sidecars as the Brain Imaging Data Structure has them (BIDS 1.10, "Common principles", tabular files).

Columns are parted by tabs, values that are missing are ``n/a``, truth values are ``true`` and ``false``, and every
column is described in a JSON file of the same name.
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
"""Of a number that is written: beyond what anything here is measured to."""


@dataclass(frozen=True)
class Column(Generic[R]):
    """One column of a table.

    Attributes:
        name: In snake case.
        description: For people.
        value: Of a row; None where it is missing.
        units: Of its numbers; none for text.
        levels: What its words mean.
    """

    name: str
    description: str
    value: Callable[[R], Any]
    units: str = ""
    levels: Mapping[str, str] | None = None

    def described(self) -> dict[str, Any]:
        """Its entry in the sidecar."""
        entry: dict[str, Any] = {"Description": self.description}
        if self.units:
            entry["Units"] = self.units
        if self.levels:
            entry["Levels"] = dict(self.levels)
        return entry


def write_table(path: Path, columns: Sequence[Column[R]], rows: Iterable[R], **fields: Any) -> None:
    """Write a table and its sidecar, whose name ends in ``.json`` instead; both folders and files are new.

    Args:
        path: Ending in ``.tsv``, or ``.tsv.gz`` for a table that is packed.
        columns: In order.
        rows: In order.
        fields: Of the sidecar, before its columns.
    """
    lines = ["\t".join(column.name for column in columns)]
    lines += ["\t".join(cell(column.value(row)) for column in columns) for row in rows]
    text = ("\n".join(lines) + "\n").encode()
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(text, mtime=0) if path.suffix == ".gz" else text)
    sidecar = path.with_name(path.name.removesuffix(".gz").removesuffix(".tsv") + ".json")
    write_json(sidecar, fields | {column.name: column.described() for column in columns})


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a sidecar, or another file of keys and values."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(msgspec.json.format(msgspec.json.encode(content), indent=2) + b"\n")


def cell(value: Any) -> str:
    """A value as a table has it: a number without noise in its last digits, text on one line."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return MISSING
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.{DIGITS}g}"
    return " ".join(str(value).split()) or MISSING


def label(text: str) -> str:
    """What is left of a name in a file's name: letters and digits."""
    return re.sub(r"[^A-Za-z0-9]", "", text) or "unknown"
