"""The journal's SQLite file: its tables, its guards, and the connections to it."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Final

from pcmrs.errors import JournalError
from pcmrs.files import publish
from pcmrs.journal.rows import Kind

HEADLESS: Final = 1
"""The version that had no signed head."""
WITHOUT_MAC: Final = 2
"""The last version whose rows had no MAC."""
VERSION: Final = 3
_HEADER: Final = 100
"""Bytes with which every SQLite file begins."""
LOCK_TIMEOUT: Final = 5.0
"""How long a write waits while another process has the file locked, s."""

# `body` is the row; the columns before it only find it again. `mac` is written as SQLite adds a
# column to an older table: an upgraded file has the same schema as a new one.
_STATEMENTS: Final = {
    "journal": """CREATE TABLE journal (
    sequence INTEGER PRIMARY KEY,
    kind TEXT NOT NULL,
    source TEXT,
    command_id TEXT,
    branch TEXT,
    wall REAL NOT NULL,
    body BLOB NOT NULL,
    previous_hash BLOB NOT NULL,
    hash BLOB NOT NULL
, mac BLOB) STRICT""",
    "one_intent": "CREATE UNIQUE INDEX one_intent ON journal (source, command_id) WHERE kind = 'intent'",
    "one_outcome": "CREATE UNIQUE INDEX one_outcome ON journal (source, command_id) WHERE kind = 'outcome'",
    "no_update": "CREATE TRIGGER no_update BEFORE UPDATE ON journal "
    "BEGIN SELECT RAISE(ABORT, 'the journal is append-only'); END",
    "no_delete": "CREATE TRIGGER no_delete BEFORE DELETE ON journal "
    "BEGIN SELECT RAISE(ABORT, 'the journal is append-only'); END",
    "no_gap": """CREATE TRIGGER no_gap BEFORE INSERT ON journal
WHEN NEW.sequence IS NOT (SELECT coalesce(max(sequence), 0) + 1 FROM journal)
BEGIN SELECT RAISE(ABORT, 'the sequence has no gaps'); END""",
}
_ADD_MAC: Final = ", mac BLOB"
INSERT: Final = "INSERT INTO journal VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"

Record = tuple[object, ...]
"""A row as the table has it."""

DATABASE_ERRORS: Final = (sqlite3.Error, UnicodeDecodeError)
"""What reading a damaged database raises; the second where even SQLite's message quotes damaged text."""


def make_database(path: Path, first: Record | None = None) -> None:
    """Makes a file of a journal, which appears under its name only when it is whole.

    Args:
        path: Of the file.
        first: The row with which it continues an earlier file; None for the first file of a journal, which is empty.

    Raises:
        JournalError: It cannot be made.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.unlink(missing_ok=True)
        with closing(sqlite3.connect(part, isolation_level=None)) as connection:
            connection.execute("BEGIN IMMEDIATE")
            connection.execute(_STATEMENTS["journal"])
            if first is not None:
                connection.execute(INSERT, first)  # before there is a trigger that lets rows begin with 1 only
            for name, statement in _STATEMENTS.items():
                if name != "journal":
                    connection.execute(statement)
            connection.execute(f"PRAGMA user_version = {VERSION}")
            connection.execute("COMMIT")
            connection.execute("PRAGMA journal_mode = WAL").fetchone()
        publish(part, path)
    except (OSError, sqlite3.Error) as error:
        raise _unusable(path, error) from error


def open_for_writing(path: Path, *, durable: bool) -> sqlite3.Connection:
    """Opens the journal in WAL mode.

    Args:
        path: Of the file, which exists.
        durable: Whether a commit waits until the disk has it (``synchronous=FULL``).

    Raises:
        JournalError: The file cannot be opened, is no journal or one of another version.
    """
    synchronous = 2 if durable else 0
    try:
        connection = sqlite3.connect(path, timeout=LOCK_TIMEOUT, isolation_level=None, check_same_thread=False)
        _check_version(connection, path)
        (mode,) = connection.execute("PRAGMA journal_mode = WAL").fetchone()
        connection.execute(f"PRAGMA synchronous = {synchronous}")
        (in_force,) = connection.execute("PRAGMA synchronous").fetchone()
        # SQLite keeps the errors of its own checkpoints to itself; the writer makes them, and hears of them.
        connection.execute("PRAGMA wal_autocheckpoint = 0")
    except DATABASE_ERRORS as error:
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
        if path.stat().st_size < _HEADER:  # SQLite takes 0 bytes and 1 for an empty file, and removes its log
            raise sqlite3.DatabaseError(f"it has only {path.stat().st_size} bytes")
        connection = sqlite3.connect(location, uri=True, isolation_level=None, check_same_thread=False)
        connection.execute("PRAGMA cell_size_check = ON")
        _check_version(connection, path)
        _check_table(connection)
    except (OSError, *DATABASE_ERRORS) as error:
        raise _unusable(path, error) from error
    return connection


def statements(version: int) -> dict[str, str]:
    """The statements that make the tables, indexes and triggers of a version, by their names."""
    if version > WITHOUT_MAC:
        return dict(_STATEMENTS)
    return {**_STATEMENTS, "journal": _STATEMENTS["journal"].replace(_ADD_MAC, "")}


def upgrade(connection: sqlite3.Connection) -> None:
    """Makes a file of an older version one of this version, in the transaction that is open; its rows get no MAC."""
    connection.execute("ALTER TABLE journal ADD COLUMN mac BLOB")
    connection.execute(f"PRAGMA user_version = {VERSION}")


def version_of(connection: sqlite3.Connection) -> int:
    """The version of an open journal."""
    version: int = connection.execute("PRAGMA user_version").fetchone()[0]
    return version


def last_sequence(connection: sqlite3.Connection, path: Path, *, kind: Kind | None = None) -> int:
    """Sequence of the last row, of its kind where one is given; 0 when there is none. Raises `JournalError`."""
    where, values = ("", ()) if kind is None else ("WHERE kind = ?", (kind,))
    query = f"SELECT sequence FROM journal {where} ORDER BY sequence DESC LIMIT 1"  # noqa: S608  # values are bound
    try:
        found = connection.execute(query, values).fetchone()
    except DATABASE_ERRORS as error:
        raise _unusable(path, error) from error
    return found[0] if found else 0


def check_schema(connection: sqlite3.Connection, path: Path) -> None:
    """The tables and guards must be those that this program makes.

    Raises:
        JournalError: One is missing or another: what it guards may have been changed.
    """
    try:
        found = dict(connection.execute("SELECT name, sql FROM sqlite_schema"))
        wanted = statements(version_of(connection))
    except DATABASE_ERRORS as error:
        raise _unusable(path, error) from error
    wrong = sorted(name for name in wanted.keys() | found.keys() if found.get(name) != wanted.get(name))
    if wrong:
        raise JournalError(
            f"{path} was changed: {', '.join(wrong)} is not as this program makes it. Keep the files as they are and "
            "go on in another cell.folder.",
            path=str(path),
            changed=wrong,
        )


def _check_version(connection: sqlite3.Connection, path: Path) -> None:
    version = version_of(connection)
    if not HEADLESS <= version <= VERSION:
        connection.close()
        raise JournalError(
            f"{path} has journal version {version}, this program knows {HEADLESS} to {VERSION}: give another file.",
            path=str(path),
            version=version,
        )


def _check_table(connection: sqlite3.Connection) -> None:
    """Raise `sqlite3.DatabaseError` unless the table is ours: a view in its place can make rows without end."""
    found = connection.execute("SELECT sql FROM sqlite_schema WHERE name = 'journal'").fetchone()
    if found != (statements(version_of(connection))["journal"],):
        connection.close()
        raise sqlite3.DatabaseError("its table is not as this program makes it")


def _unusable(path: Path, error: Exception) -> JournalError:
    return JournalError(f"{path} cannot be used as a journal: {error}. Give another file.", path=str(path))
