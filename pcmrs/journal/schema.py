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
"""Version without a signed head."""
WITHOUT_MAC: Final = 2
"""Last version whose rows had no MAC."""
VERSION: Final = 3
_HEADER: Final = 100
"""Size of the header of an SQLite file, bytes."""
LOCK_TIMEOUT: Final = 5.0
"""Time that a write waits while another process has the file locked, s."""

# `body` is the row; the columns before it only serve to find it. `mac` is written as SQLite adds a
# column to an older table: so an upgraded file has the same schema as a new one.
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
"""Values of a row of the table."""

DATABASE_ERRORS: Final = (sqlite3.Error, UnicodeDecodeError)
"""Errors of reading a damaged database; the second if SQLite's message itself quotes damaged text."""


def make_database(path: Path, first: Record | None = None) -> None:
    """Create a journal file; it appears under its name only when it is complete.

    Args:
        path: Path of the file.
        first: Row with which it continues an earlier file; None for the first file of a journal, which is empty.

    Raises:
        JournalError: The file cannot be created.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.unlink(missing_ok=True)
        with closing(sqlite3.connect(part, isolation_level=None)) as connection:
            connection.execute("BEGIN IMMEDIATE")
            connection.execute(_STATEMENTS["journal"])
            if first is not None:
                connection.execute(INSERT, first)  # before the trigger that requires the first sequence to be 1
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
    """Open a journal file in WAL mode.

    Args:
        path: Path of the file. It must exist.
        durable: True to wait at each commit until it is on the disk (``synchronous=FULL``).

    Raises:
        JournalError: The file cannot be opened, is not a journal, or has another version.
    """
    synchronous = 2 if durable else 0
    try:
        connection = sqlite3.connect(path, timeout=LOCK_TIMEOUT, isolation_level=None, check_same_thread=False)
        _check_version(connection, path)
        (mode,) = connection.execute("PRAGMA journal_mode = WAL").fetchone()
        connection.execute(f"PRAGMA synchronous = {synchronous}")
        (in_force,) = connection.execute("PRAGMA synchronous").fetchone()
        # SQLite does not report errors of its automatic checkpoints; the writer makes them, to see the errors.
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
    """Open an existing journal file for reading, also while a daemon writes it.

    Raises:
        JournalError: There is no such file, it is not a journal, or has another version.
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
    """Return the statements that create the tables, indexes and triggers of a version, by their names."""
    if version > WITHOUT_MAC:
        return dict(_STATEMENTS)
    return {**_STATEMENTS, "journal": _STATEMENTS["journal"].replace(_ADD_MAC, "")}


def upgrade(connection: sqlite3.Connection) -> None:
    """Upgrade a file of an older version to this version, in the open transaction; its rows get no MAC."""
    connection.execute("ALTER TABLE journal ADD COLUMN mac BLOB")
    connection.execute(f"PRAGMA user_version = {VERSION}")


def version_of(connection: sqlite3.Connection) -> int:
    """Return the version of an open journal file."""
    version: int = connection.execute("PRAGMA user_version").fetchone()[0]
    return version


def last_sequence(connection: sqlite3.Connection, path: Path, *, kind: Kind | None = None) -> int:
    """Return the sequence of the last row; 0 if there is none.

    Args:
        connection: Connection to the file.
        path: Path of the file, for the message.
        kind: Kind of the row; None for any.

    Raises:
        JournalError: The file cannot be read.
    """
    where, values = ("", ()) if kind is None else ("WHERE kind = ?", (kind,))
    query = f"SELECT sequence FROM journal {where} ORDER BY sequence DESC LIMIT 1"  # noqa: S608  # values are bound
    try:
        found = connection.execute(query, values).fetchone()
    except DATABASE_ERRORS as error:
        raise _unusable(path, error) from error
    return found[0] if found else 0


def check_schema(connection: sqlite3.Connection, path: Path) -> None:
    """Require that tables, indexes and triggers are those that this program creates.

    Args:
        connection: Connection to the file.
        path: Path of the file, for the message.

    Raises:
        JournalError: One is missing or differs: what it guards may have been changed.
    """
    try:
        found = dict(connection.execute("SELECT name, sql FROM sqlite_schema"))
        wanted = statements(version_of(connection))
    except DATABASE_ERRORS as error:
        raise _unusable(path, error) from error
    wrong = sorted(name for name in wanted.keys() | found.keys() if found.get(name) != wanted.get(name))
    if wrong:
        raise JournalError(
            f"{path} was changed: {', '.join(wrong)} differs from what this program creates. Keep the files unchanged "
            "and continue in another cell.folder.",
            path=str(path),
            changed=wrong,
        )


def _check_version(connection: sqlite3.Connection, path: Path) -> None:
    version = version_of(connection)
    if not HEADLESS <= version <= VERSION:
        connection.close()
        raise JournalError(
            f"{path} has journal version {version}, this program supports {HEADLESS} to {VERSION}: give another file.",
            path=str(path),
            version=version,
        )


def _check_table(connection: sqlite3.Connection) -> None:
    """Raise `sqlite3.DatabaseError` unless the table is ours: a view in its place could produce endless rows."""
    found = connection.execute("SELECT sql FROM sqlite_schema WHERE name = 'journal'").fetchone()
    if found != (statements(version_of(connection))["journal"],):
        connection.close()
        raise sqlite3.DatabaseError("its table differs from what this program creates")


def _unusable(path: Path, error: Exception) -> JournalError:
    return JournalError(f"{path} cannot be used as a journal: {error}. Give another file.", path=str(path))
