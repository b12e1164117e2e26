"""Catalogue of an archive in a folder: an SQLite file that names its journals, and each segment with its hash.

A segment counts when it is in the catalogue. Its file is written before: a run that is killed in between leaves a file
that no question reads, and that the next run replaces.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from pcmrs.archive._segment import JournalName, Segment, added_by_another_run
from pcmrs.archive._store import ArchivedJournal
from pcmrs.errors import ArchiveError
from pcmrs.files import publish
from pcmrs.journal.rows import RowPosition

VERSION: Final = 1
LOCK_TIMEOUT: Final = 30.0
"""Time that a run waits for the catalogue while another one writes it, s."""

_TABLES: Final = (
    "CREATE TABLE journals (site TEXT NOT NULL, cell TEXT NOT NULL, workflow TEXT NOT NULL, first TEXT PRIMARY KEY, "
    "key BLOB NOT NULL, head BLOB NOT NULL) STRICT",
    "CREATE TABLE segments (journal TEXT NOT NULL REFERENCES journals, start INTEGER NOT NULL, start_hash BLOB "
    "NOT NULL, last INTEGER NOT NULL, last_hash BLOB NOT NULL, bytes INTEGER NOT NULL, sha256 BLOB NOT NULL, "
    "PRIMARY KEY (journal, start)) STRICT",
)


@dataclass(frozen=True, slots=True)
class ListedSegment:
    """A segment in the catalogue.

    Attributes:
        segment: The segment.
        size: Size of its file, bytes.
        sha256: Hash of its file.
    """

    segment: Segment
    size: int
    sha256: bytes


class Catalogue:
    """The catalogue of an archive, used by one thread at a time.

    Args:
        path: Its file.
        make: True to make a new one if there is none.

    Raises:
        ArchiveError: From all methods: the file is missing, is of another version, or cannot be used.
    """

    def __init__(self, path: Path, *, make: bool) -> None:
        self._path = path
        if not (make or path.exists()):
            text = f"{path.parent} is not an archive: `pcmrs archive add --archive {path.parent}` makes one."
            raise ArchiveError(text, path=str(path.parent))
        with self._readable_errors():
            if not path.exists():
                _make(path)
            self._connection = sqlite3.connect(
                path, timeout=LOCK_TIMEOUT, isolation_level=None, check_same_thread=False
            )
            try:
                self._require_own()
            except BaseException:
                self._connection.close()
                raise

    def _require_own(self) -> None:
        """Require that version and tables are those of this program: a view in their place could have endless rows."""
        (version,) = self._connection.execute("PRAGMA user_version").fetchone()
        if version != VERSION:
            text = f"{self._path} has version {version}, this program supports {VERSION}: use the PCMRS that wrote it."
            raise ArchiveError(text, path=str(self._path), version=version)
        found = self._connection.execute("SELECT sql FROM sqlite_schema WHERE sql IS NOT NULL")
        if {sql for (sql,) in found} != set(_TABLES):
            text = f"{self._path} has other tables than the catalogue of an archive: put it back from a copy."
            raise ArchiveError(text, path=str(self._path))
        self._connection.execute("PRAGMA synchronous = FULL")

    def close(self) -> None:
        """Close the file."""
        self._connection.close()

    def journals(self) -> list[ArchivedJournal]:
        """Return the journals in the order of their names."""
        query = "SELECT site, cell, workflow, first, key, head FROM journals ORDER BY site, cell, workflow, first"
        with self._readable_errors():
            return [ArchivedJournal(JournalName(*row[:4]), *row[4:]) for row in self._connection.execute(query)]

    def segments(self, journal: JournalName) -> list[ListedSegment]:
        """Return the segments of a journal in order of their first rows."""
        query = (
            "SELECT start, start_hash, last, last_hash, bytes, sha256 FROM segments WHERE journal = ? ORDER BY start"
        )
        with self._readable_errors():
            return [
                ListedSegment(Segment(journal, RowPosition(*row[:2]), RowPosition(*row[2:4])), *row[4:])
                for row in self._connection.execute(query, (journal.first,))
            ]

    def begin(self, journal: ArchivedJournal) -> None:
        """Enter a journal.

        Raises:
            DoubledSegmentError: It is there: another run was faster.
        """
        values = (*journal.name, journal.key, journal.head)
        with self._readable_errors():
            try:
                self._connection.execute("INSERT INTO journals VALUES (?, ?, ?, ?, ?, ?)", values)
            except sqlite3.IntegrityError as error:
                raise added_by_another_run(journal.name) from error

    @contextmanager
    def entering(self, listed: ListedSegment) -> Iterator[None]:
        """Enter a segment when the block ends, in which its file gets its name; no other run enters one before.

        Args:
            listed: The segment.

        Raises:
            DoubledSegmentError: It does not follow the last segment of its journal: another run was faster.
        """
        segment = listed.segment
        with self._readable_errors():
            self._connection.execute("BEGIN IMMEDIATE")
        try:
            self._require_next(segment)
            yield
            with self._readable_errors():
                values = (segment.start.sequence, segment.start.hash, segment.end.sequence, segment.end.hash)
                self._connection.execute(
                    "INSERT INTO segments VALUES (?, ?, ?, ?, ?, ?, ?)",
                    (segment.journal.first, *values, listed.size, listed.sha256),
                )
                self._connection.execute("COMMIT")
        finally:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")

    def prove(self, journal: JournalName, head: bytes) -> None:
        """Store the head that proves the rows of a journal.

        Args:
            journal: Name of the journal.
            head: Bytes of the head file.
        """
        with self._readable_errors():
            self._connection.execute("UPDATE journals SET head = ? WHERE first = ?", (head, journal.first))

    def _require_next(self, segment: Segment) -> None:
        query = "SELECT coalesce(max(last), 0) FROM segments WHERE journal = ?"
        with self._readable_errors():
            (last,) = self._connection.execute(query, (segment.journal.first,)).fetchone()
        if last != segment.start.sequence:
            raise added_by_another_run(segment.journal, last, segment)

    @contextmanager
    def _readable_errors(self) -> Iterator[None]:
        try:
            yield
        except (OSError, sqlite3.Error) as error:
            text = f"The catalogue {self._path} cannot be used: {error}. Put it on a local disk with free space."
            raise ArchiveError(text, path=str(self._path)) from error


def _make(path: Path) -> None:
    part = path.with_name(path.name + ".part")
    part.unlink(missing_ok=True)
    with closing(sqlite3.connect(part, isolation_level=None)) as connection:
        for statement in _TABLES:
            connection.execute(statement)
        connection.execute(f"PRAGMA user_version = {VERSION}")
    publish(part, path)
