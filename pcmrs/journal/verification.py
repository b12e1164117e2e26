"""Verification of a whole journal: each row, each index, and the signed head."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Literal

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from pcmrs.errors import JournalError
from pcmrs.journal.chain import follow_chain
from pcmrs.journal.head import HeadState, head_path, read_head
from pcmrs.journal.keys import PUBLIC, public_key
from pcmrs.journal.reader import journal_files
from pcmrs.journal.rows import START, RowPosition
from pcmrs.journal.schema import DATABASE_ERRORS, HEADLESS, check_schema, last_sequence, open_for_reading, version_of
from pcmrs.journal.soundness import require_head, require_named, require_rows, wrong_row
from pcmrs.messages import Message

Progress = Callable[[str, int, int], None]
"""Callback for the present step, the amount done, and the total."""


class JournalVerification(Message, frozen=True, kw_only=True, omit_defaults=False):
    """Result of a verification.

    Attributes:
        journal: Path of the journal.
        version: Version of the file; 0 if it is unknown.
        rows: Number of rows, from the first on, that are whole and follow from each other.
        first_bad: Sequence of the first row that is missing, changed or unreadable; None if all are good.
        signed: Number of rows, from the first on, that the signature of the head proves.
        missing: Number of rows that the head names and the journal lacks.
        unnamed: Number of rows after the last one that the head names; it does not prove them. The next start of a
            daemon, which has the key of their MACs, adopts or refuses them.
        signature: Signature of the head; ``none`` for a version of the journal without a head.
        head: Last row that the head names, its hash in hexadecimal, and the number of writes of the head.
        damaged_slots: Number of damaged slots of the head, of two.
        problems: Problems, one sentence each; empty if the journal is good.
    """

    journal: str
    version: int
    rows: int
    first_bad: int | None
    signed: int
    missing: int
    unnamed: int
    signature: Literal["holds", "does not hold", "none"]
    head: tuple[int, str, int] | None
    damaged_slots: int
    problems: tuple[str, ...]

    @property
    def sound(self) -> bool:
        """True if the journal is complete and unchanged."""
        return not self.problems


def verify(
    path: Path, *, public: Path | None = None, kept: Path | None = None, progress: Progress | None = None
) -> JournalVerification:
    """Verify a whole journal, also while a daemon writes it, without changing anything.

    Args:
        path: First file of the journal.
        public: Public key in PEM; None for `journal.pub` beside the journal. A key from elsewhere shows that the
            pair was not replaced.
        kept: Earlier copy of the head, stored elsewhere; it shows that journal and head were not set back together.
        progress: Callback for the number of rows read.

    Raises:
        JournalError: There is no journal, or no key.
    """
    if not path.exists() and not head_path(path).exists():
        raise JournalError(f"There is no journal {path}.", path=str(path))
    key = _key(path, public)
    # The head is read before the rows, which must reach it, and again after them, which may not go far beyond it.
    before = _head(head_path(path), key)
    earlier = None if kept is None else _head(kept, key)
    reading = _JournalCheck(path, {state.head.place for state in (before, earlier) if state is not None and state.head})
    reading.attempt(lambda: reading.read(progress or (lambda *_: None)))
    reading.attempt(lambda: reading.compare(before, _head(head_path(path), key)))
    if kept is not None and (earlier is None or earlier.head is None or earlier.head.place not in reading.reached):
        reading.problems.append(f"The journal does not hold the row that {kept} names, or that file is not its head.")
    return reading.report(before)


def _key(path: Path, public: Path | None) -> Ed25519PublicKey | None:
    """Return the key to verify with; None for a journal without head and key, as of version 1."""
    beside = path.parent / PUBLIC
    return public_key(public or beside) if public or beside.exists() or head_path(path).exists() else None


def _head(path: Path, key: Ed25519PublicKey | None) -> HeadState | None:
    return None if key is None else read_head(path, key)


class _JournalCheck:
    """The reading of a journal, continued after a problem as far as possible.

    Args:
        path: First file of the journal.
        named: Positions that heads name.

    Attributes:
        problems: Problems found so far.
        reached: Those of `named` that the rows have.
    """

    def __init__(self, path: Path, named: set[RowPosition]) -> None:
        self.problems: list[str] = []
        self.reached = named & {START}
        self._path = path
        self._named = named
        self._version = 0
        self._end = START
        self._first_bad: int | None = None
        self._unnamed = 0

    def attempt(self, part: Callable[[], None]) -> None:
        """Run a part of the reading and store its problem."""
        try:
            part()
        except DATABASE_ERRORS as error:
            self.problems.append(f"{self._path} cannot be read: {error}.")
        except JournalError as error:
            self.problems.append(error.text)
            self._first_bad = error.fields.get("sequence", self._first_bad)

    def read(self, progress: Progress) -> None:
        """Read all rows and pages.

        Raises:
            JournalError: A row is bad; the field ``sequence`` names it.
        """
        files = journal_files(self._path)
        if files == [self._path] and (not self._path.exists() or self._path.stat().st_size == 0):
            return
        with closing(open_for_reading(files[-1])) as newest:
            total = last_sequence(newest, files[-1])
        progress("rows", 0, total)
        for path in files:
            with closing(open_for_reading(path)) as connection:
                self._read_file(path, connection, lambda done: progress("rows", done, max(done, total)))

    def _read_file(self, path: Path, connection: sqlite3.Connection, done: Callable[[int], None]) -> None:
        self._version = version_of(connection)
        self.attempt(lambda: check_schema(connection, path))
        connection.execute("BEGIN")  # one view of rows and indexes
        end = last_sequence(connection, path)
        for stored in follow_chain(connection, path, self._end):
            self._end = RowPosition(stored.sequence, stored.hash)
            if self._end in self._named:
                self.reached.add(self._end)
            if stored.sequence % 1000 == 0 or stored.sequence == end:
                done(stored.sequence)
        self._check_pages(path, connection)

    def compare(self, before: HeadState | None, after: HeadState | None) -> None:
        """Compare the rows with the head.

        Args:
            before: Head as it was before the rows were read; None if there was none.
            after: Head as it was after that.

        Raises:
            JournalError: The rows do not match the head.
        """
        head = require_head(self._path, before, self._version)
        if head is None or self._first_bad is not None:
            return
        require_rows(self._path, head.place, self._end)
        if head.place not in self.reached:
            raise wrong_row(self._path, head.place)
        if after is not None and after.head is not None:
            self._unnamed = max(0, self._end.sequence - after.head.place.sequence)
            require_named(self._path, self._unnamed, after.damaged)

    def report(self, before: HeadState | None) -> JournalVerification:
        """Return the result.

        Args:
            before: Head as it was before the rows were read.
        """
        head = before.head if before is not None else None
        return JournalVerification(
            journal=str(self._path),
            version=self._version,
            rows=self._end.sequence,
            first_bad=self._first_bad,
            signed=head.place.sequence if head is not None and head.place in self.reached else 0,
            missing=0 if head is None or self._first_bad else max(0, head.place.sequence - self._end.sequence),
            unnamed=self._unnamed,
            signature="holds" if head else "none" if before is None and self._version == HEADLESS else "does not hold",
            head=None if head is None else (head.place.sequence, head.place.hash.hex(), head.counter),
            damaged_slots=before.damaged if before is not None else 0,
            problems=tuple(self.problems),
        )

    def _check_pages(self, path: Path, connection: sqlite3.Connection) -> None:
        """Run SQLite's own check of pages and indexes."""
        try:
            found = [line for (line,) in connection.execute("PRAGMA integrity_check(10)")]
        except DATABASE_ERRORS as error:
            found = [str(error)]
        if found != ["ok"]:
            self.problems.append(f"The database is damaged, {path.name}: {'; '.join(map(str, found))}.")
