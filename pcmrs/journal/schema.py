"""The journal's SQLite file: its tables, its guards, and the connections to it."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import Final

from pcmrs.errors import JournalError

VERSION: Final = 1

# `body` is the row; the columns beside it only find it again.
_SCHEMA: Final = f"""
BEGIN IMMEDIATE;
CREATE TABLE journal (
    sequence INTEGER PRIMARY KEY,
    kind TEXT NOT NULL,
    source TEXT,
    command_id TEXT,
    branch TEXT,
    wall REAL NOT NULL,
    body BLOB NOT NULL,
    previous_hash BLOB NOT NULL,
    hash BLOB NOT NULL
) STRICT;
CREATE UNIQUE INDEX one_intent ON journal (source, command_id) WHERE kind = 'intent';
CREATE UNIQUE INDEX one_outcome ON journal (source, command_id) WHERE kind = 'outcome';
CREATE TRIGGER no_update BEFORE UPDATE ON journal BEGIN SELECT RAISE(ABORT, 'the journal is append-only'); END;
CREATE TRIGGER no_delete BEFORE DELETE ON journal BEGIN SELECT RAISE(ABORT, 'the journal is append-only'); END;
CREATE TRIGGER no_gap BEFORE INSERT ON journal
WHEN NEW.sequence IS NOT (SELECT coalesce(max(sequence), 0) + 1 FROM journal)
BEGIN SELECT RAISE(ABORT, 'the sequence has no gaps'); END;
PRAGMA user_version = {VERSION};
COMMIT;
"""


def open_for_writing(path: Path, *, durable: bool) -> sqlite3.Connection:
    """Opens the journal, or makes it, in WAL mode.

    Args:
        path: Of the file; its folder exists.
        durable: Whether a commit waits until the disk has it (``synchronous=FULL``).

    Raises:
        JournalError: The file cannot be opened, is no journal or one of another version.
    """
    synchronous = 2 if durable else 0
    try:
        connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False)
        if not connection.execute("PRAGMA schema_version").fetchone()[0]:
            connection.executescript(_SCHEMA)
        _check_version(connection, path)
        (mode,) = connection.execute("PRAGMA journal_mode = WAL").fetchone()
        connection.execute(f"PRAGMA synchronous = {synchronous}")
        (in_force,) = connection.execute("PRAGMA synchronous").fetchone()
    except sqlite3.Error as error:
        raise _unusable(path, error) from error
    if (mode, in_force) != ("wal", synchronous):
        raise JournalError(
            f"{path} cannot be written safely: journal mode {mode}, synchronous {in_force}; wal and "
            f"{synchronous} are needed. Put the journal on a local disk.",
            path=str(path),
        )
    return connection


def open_for_reading(path: Path) -> sqlite3.Connection:
    """Opens an existing journal, also while a daemon writes it.

    Raises:
        JournalError: There is no such file, it is no journal or one of another version.
    """
    location = f"{path.resolve().as_uri()}?mode=ro"
    try:
        connection = sqlite3.connect(location, uri=True, isolation_level=None, check_same_thread=False)
        _check_version(connection, path)
    except sqlite3.Error as error:
        raise _unusable(path, error) from error
    return connection


def _check_version(connection: sqlite3.Connection, path: Path) -> None:
    (version,) = connection.execute("PRAGMA user_version").fetchone()
    if version != VERSION:
        connection.close()
        raise JournalError(
            f"{path} has journal version {version}, this program knows {VERSION}: give another file.",
            path=str(path),
            version=version,
        )


def _unusable(path: Path, error: sqlite3.Error) -> JournalError:
    return JournalError(f"{path} cannot be used as a journal: {error}. Give another file.", path=str(path))
