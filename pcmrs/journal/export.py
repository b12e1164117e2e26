"""Export of a journal: rows as JSON or CSV, and a copy of the database files with its head and public key."""

from __future__ import annotations

import csv
import datetime
import io
import shutil
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import msgspec

from pcmrs.errors import JournalError
from pcmrs.journal.head import head_path, read_head
from pcmrs.journal.keys import PUBLIC, public_key
from pcmrs.journal.reader import journal_files, numbered
from pcmrs.journal.rows import StoredRow
from pcmrs.journal.schema import DATABASE_ERRORS, HEADLESS, last_sequence, open_for_reading, version_of

_TRIES: Final = 20


def copy_journal(source: Path, target: Path) -> None:
    """Copy a journal with all its files so that `verify` gives the same result; a daemon may be writing it.

    Args:
        source: First file of the journal.
        target: First file of the copy; the head and `journal.pub` are written beside it.

    Raises:
        JournalError: The journal cannot be read or copied, or is written too fast to copy its head with it.
        OSError: The copy cannot be written.
    """
    for _ in range(_TRIES):
        before = _head_bytes(source)
        version, last = _copy_database(source, target)
        if version == HEADLESS and before is None:
            return
        if before is None:
            raise JournalError(f"{head_path(source)} is missing: `pcmrs journal verify {source}`.", path=str(source))
        after = _head_bytes(source)
        shutil.copyfile(source.parent / PUBLIC, target.parent / PUBLIC)
        for head in (before, after or before):
            head_path(target).write_bytes(head)
            state = read_head(head_path(target), public_key(target.parent / PUBLIC))
            named = state.head.place.sequence if state is not None and state.head is not None else None
            # Without a writer, head and rows may differ by what a crash left.
            if named == last or before == after:
                return
    raise JournalError(f"{source} is written too fast to be copied with its head: try again.", path=str(source))


def _head_bytes(journal: Path) -> bytes | None:
    path = head_path(journal)
    return path.read_bytes() if path.exists() else None


def _copy_database(source: Path, target: Path) -> tuple[int, int]:
    """Return the version and the last sequence of the copy."""
    version = last = 0
    try:
        for number, file in enumerate(journal_files(source), start=1):
            path = numbered(target, number)
            with closing(open_for_reading(file)) as written, closing(sqlite3.connect(path)) as copy:
                written.backup(copy)
                copy.execute("PRAGMA journal_mode = DELETE")  # no log beside it, since nobody writes it any more
                version, last = version_of(copy), last_sequence(copy, path)
        return version, last
    except DATABASE_ERRORS as error:
        raise JournalError(f"{source} cannot be copied to {target}: {error}.", path=str(source)) from error


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
"""Columns of the CSV export: ``time`` is UTC (ISO 8601), ``wall`` the same in Unix seconds, ``monotonic`` seconds of
the cell's clock; arguments, states and result are JSON, the hash is hexadecimal."""


def json_lines(rows: Iterable[StoredRow]) -> Iterator[str]:
    """Yield a line of JSON for each row; bytes are in base64."""
    for stored in rows:
        yield msgspec.json.encode(stored).decode() + "\n"


def csv_lines(rows: Iterable[StoredRow]) -> Iterator[str]:
    """Yield the line of `CSV_COLUMNS`, then a line for each row; missing values are empty."""
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
