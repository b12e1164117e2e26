"""Reading a whole journal to say what is good in it: every row, every index, and what the signed head says."""

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
from pcmrs.journal.rows import START, Place
from pcmrs.journal.schema import DATABASE_ERRORS, HEADLESS, check_schema, last_sequence, open_for_reading, version_of
from pcmrs.journal.soundness import another_row, require_head, require_named, require_rows
from pcmrs.messages import Message

Progress = Callable[[str, int, int], None]
"""Is told what is done now, how much is done, and of how much."""


class Verification(Message, frozen=True, kw_only=True, omit_defaults=False):
    """What is good in a journal.

    Attributes:
        journal: Its path.
        version: Of the file; 0 when it cannot be told.
        rows: So many rows from the first on are whole and follow from each other.
        first_bad: Sequence of the first row that is missing, changed or unreadable; None when all are good.
        signed: So many rows from the first on are proven by the signature of the head.
        missing: Rows that the head names, and that are not there.
        unnamed: Rows after the last one that the head names: it does not prove them. The next start of a
            daemon, which has the key of their MACs, takes them up or refuses them.
        signature: Of the head; ``none``: it has no head, since the version of the journal knows none.
        head: The last row that the head names, its hash in hexadecimal, and how often the head was written.
        damaged_slots: Of the two slots of the head.
        problems: What is not as it must be; empty when the journal is good.
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
        """Whether everything is there, and as it was written."""
        return not self.problems


def verify(
    path: Path, *, public: Path | None = None, kept: Path | None = None, progress: Progress | None = None
) -> Verification:
    """Reads a journal as a whole, also while a daemon writes it, and changes nothing.

    Args:
        path: Of the journal.
        public: The public key in PEM; `journal.pub` beside the journal when None. One from elsewhere shows that the
            pair was not replaced.
        kept: A copy of the head from an earlier time, kept elsewhere: shows that journal and head were not set back
            together.
        progress: Is told how many rows are read.

    Raises:
        JournalError: There is no journal, or no key.
    """
    if not path.exists() and not head_path(path).exists():
        raise JournalError(f"There is no journal {path}.", path=str(path))
    key = _key(path, public)
    # The head is read before the rows, which must reach it, and again after them: they may not go far beyond it.
    before = _head(head_path(path), key)
    earlier = None if kept is None else _head(kept, key)
    reading = _Reading(path, {state.head.place for state in (before, earlier) if state is not None and state.head})
    reading.attempt(lambda: reading.read(progress or (lambda *_: None)))
    reading.attempt(lambda: reading.compare(before, _head(head_path(path), key)))
    if kept is not None and (earlier is None or earlier.head is None or earlier.head.place not in reading.reached):
        reading.problems.append(f"The journal does not hold the row that {kept} names, or that is no head of it.")
    return reading.report(before)


def _key(path: Path, public: Path | None) -> Ed25519PublicKey | None:
    """The key to verify with; None for a journal that has no head and no key, as version 1."""
    beside = path.parent / PUBLIC
    return public_key(public or beside) if public or beside.exists() or head_path(path).exists() else None


def _head(path: Path, key: Ed25519PublicKey | None) -> HeadState | None:
    return None if key is None else read_head(path, key)


class _Reading:
    """What is found while a journal is read, which goes on after a problem as far as it can.

    Args:
        path: Of the journal.
        named: Places that heads name.

    Attributes:
        reached: Those of them that the rows have.
    """

    def __init__(self, path: Path, named: set[Place]) -> None:
        self.problems: list[str] = []
        self.reached = named & {START}
        self._path = path
        self._named = named
        self._version = 0
        self._end = START
        self._first_bad: int | None = None
        self._unnamed = 0

    def attempt(self, part: Callable[[], None]) -> None:
        """Does a part of the reading, and keeps what is wrong."""
        try:
            part()
        except DATABASE_ERRORS as error:
            self.problems.append(f"{self._path} cannot be read: {error}.")
        except JournalError as error:
            self.problems.append(error.text)
            self._first_bad = error.fields.get("sequence", self._first_bad)

    def read(self, progress: Progress) -> None:
        """Reads all rows and pages. Raises `JournalError` at the first bad row."""
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
            self._end = Place(stored.sequence, stored.hash)
            if self._end in self._named:
                self.reached.add(self._end)
            if stored.sequence % 1000 == 0 or stored.sequence == end:
                done(stored.sequence)
        self._check_pages(path, connection)

    def compare(self, before: HeadState | None, after: HeadState | None) -> None:
        """Compares the rows with the head as it was before they were read, and after. Raises `JournalError`."""
        head = require_head(self._path, before, self._version)
        if head is None or self._first_bad is not None:
            return
        require_rows(self._path, head.place, self._end)
        if head.place not in self.reached:
            raise another_row(self._path, head.place)
        if after is not None and after.head is not None:
            self._unnamed = max(0, self._end.sequence - after.head.place.sequence)
            require_named(self._path, self._unnamed, after.damaged)

    def report(self, before: HeadState | None) -> Verification:
        """What was found."""
        head = before.head if before is not None else None
        return Verification(
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
        """SQLite's own check of pages and indexes."""
        try:
            found = [line for (line,) in connection.execute("PRAGMA integrity_check(10)")]
        except DATABASE_ERRORS as error:
            found = [str(error)]
        if found != ["ok"]:
            self.problems.append(f"The database is damaged, {path.name}: {'; '.join(map(str, found))}.")
