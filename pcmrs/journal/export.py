"""Rows as lines of other formats."""

from __future__ import annotations

import csv
import datetime
import io
from collections.abc import Iterable, Iterator
from typing import Any, Final

import msgspec

from pcmrs.journal.rows import StoredRow

CSV_COLUMNS: Final = (
    "sequence",
    "time",
    "wall",
    "monotonic",
    "kind",
    "source",
    "command_id",
    "branch",
    "operation",
    "decision",
    "reason",
    "state",
    "arguments",
    "states",
    "result",
    "parent",
    "session_id",
    "boot_id",
    "blueprint",
    "hash",
)
"""Of a table: ``time`` is the wall's in UTC (ISO 8601), ``wall`` the same in Unix seconds, ``monotonic`` seconds of the
cell's clock; arguments, states and result are JSON, the hash is hexadecimal."""


def json_lines(rows: Iterable[StoredRow]) -> Iterator[str]:
    """One row of JSON per line; bytes are in base64."""
    for stored in rows:
        yield msgspec.json.encode(stored).decode() + "\n"


def csv_lines(rows: Iterable[StoredRow]) -> Iterator[str]:
    """A line of `CSV_COLUMNS`, and one for each row; what a row does not have is empty."""
    yield _line(CSV_COLUMNS)
    for stored in rows:
        values = _values(stored)
        yield _line(values[column] for column in CSV_COLUMNS)


def _values(stored: StoredRow) -> dict[str, Any]:
    row, verdict = stored.row, stored.row.verdict
    return {
        **{name: getattr(row, name) for name in ("wall", "monotonic", "kind", "source", "command_id", "branch")},
        **{name: getattr(row, name) for name in ("operation", "parent", "session_id", "boot_id")},
        **{name: _json(getattr(row, name)) for name in ("arguments", "states", "result")},
        "sequence": stored.sequence,
        "time": datetime.datetime.fromtimestamp(row.wall, datetime.UTC).isoformat(timespec="milliseconds"),
        "decision": verdict.decision if verdict is not None else None,
        "reason": verdict.reason.code if verdict is not None and verdict.reason is not None else None,
        "state": verdict.state if verdict is not None else None,
        "blueprint": f"{row.blueprint.id} {row.blueprint.version} {row.blueprint.hash}",
        "hash": stored.hash.hex(),
    }


def _json(value: Any) -> str | None:
    return None if value is None else msgspec.json.encode(value, order="sorted").decode()


def _line(values: Iterable[Any]) -> str:
    line = io.StringIO()
    csv.writer(line).writerow(values)
    return line.getvalue()
