"""Journals that somebody has edited, and what is in them."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader
from pcmrs.testing.journal import contents

GUARDS = ("no_update", "no_delete", "no_gap")


def edit(path: Path, statement: str, values: tuple[Any, ...] = ()) -> None:
    """Puts the guards back afterwards."""
    connection = sqlite3.connect(path)
    with connection:
        guards = dict(connection.execute("SELECT name, sql FROM sqlite_schema WHERE type = 'trigger'"))
        for name in GUARDS:
            connection.execute(f"DROP TRIGGER {name}")
        connection.execute(statement, values)
        for name in GUARDS:
            connection.execute(guards[name])
    connection.close()


def make_index(path: Path, name: str, condition: str) -> None:
    """Makes an index of other rows than its definition says."""
    connection = sqlite3.connect(path, isolation_level=None)
    (sql,) = connection.execute("SELECT sql FROM sqlite_schema WHERE name = ?", (name,)).fetchone()
    connection.execute(f"DROP INDEX {name}")
    connection.execute(f"{sql} {condition}")
    connection.execute("PRAGMA writable_schema = ON")
    connection.execute("UPDATE sqlite_schema SET sql = ? WHERE name = ?", (sql, name))
    connection.close()


def operations(path: Path) -> list[str | None]:
    with JournalReader(path) as reader:
        return [stored.row.operation for stored in reader.read(source="journal")]


def alter(path: Path, *statements: str) -> None:
    """As somebody with SQLite's own tool."""
    with sqlite3.connect(path) as connection:
        for statement in statements:
            connection.execute(statement)
    connection.close()


def macs(path: Path) -> list[bytes | None]:
    with closing(sqlite3.connect(path)) as connection:
        return [mac for (mac,) in connection.execute("SELECT mac FROM journal ORDER BY sequence")]


def check_refused(path: Path, sequence: int, words: str) -> None:
    before = contents(path.parent)
    with pytest.raises(
        JournalError, match=rf"row {sequence} follows the last one.*{words}.*another cell.folder"
    ) as told:
        Journal.open(path)
    assert told.value.fields["sequence"] == sequence
    assert contents(path.parent).items() >= before.items(), "the journal was changed"
