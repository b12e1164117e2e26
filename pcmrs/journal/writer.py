"""Writing the journal: rows get their sequence and their place in the hash chain in one transaction."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final

from pcmrs.errors import JournalError
from pcmrs.failpoints import failpoint
from pcmrs.files import settle_on_disk
from pcmrs.journal.chain import mac_key, row_mac
from pcmrs.journal.head import Head, HeadFile, begin_head, head_path
from pcmrs.journal.notes import continued_row, note_rows, reopened_rows
from pcmrs.journal.reader import LARGEST, journal_files, numbered
from pcmrs.journal.rows import START, JournalRow, Place, chain_hash, encode_row
from pcmrs.journal.schema import DATABASE_ERRORS, INSERT, VERSION, Record, make_database, open_for_writing, upgrade
from pcmrs.journal.soundness import Found, examine

_CHECKPOINT_AFTER: Final = 200
"""Commits after which the log is carried over into the database, about 1000 pages."""

Encoded = tuple[JournalRow, bytes]
"""A row and its canonical bytes."""


class JournalWriter:
    """The one writer of a journal, used by one thread at a time.

    After an error it writes nothing more, since what is acknowledged afterwards could not be trusted, until
    `reopen` has found out what the disk has.

    Args:
        path: Of the first file; its folder exists.
        durable: Whether a commit waits until the disk has it.
        largest: Size beyond which it goes on in a new file, bytes.

    Attributes:
        place: Of the last row that was written, and that the head names.
        error: Why nothing can be written any more.

    Raises:
        JournalError: The file cannot be opened, is no journal or one of another version, or not all is there that
            its head names; see `examine`.
    """

    def __init__(self, path: Path, *, durable: bool, largest: float = LARGEST) -> None:
        self._path = path
        self._durable = durable
        self._largest = largest
        self.error: JournalError | None = None
        self.place = START
        self._file = path
        self._connection: sqlite3.Connection
        self._last: JournalRow | None = None
        self._failed: Place | None = None
        self._attempts: set[Place] = set()
        self._commits = 0
        self._take_up(self._open())

    def write(self, rows: Sequence[Encoded]) -> int:
        """Commits the rows together and returns the sequence of the last.

        Raises:
            JournalError: They cannot be written, or an earlier write failed. Its field ``sequence`` is the one that
                the last row would have, None when nothing was tried.
        """
        if self.error is not None:
            raise JournalError(self.error.text, sequence=None)
        return self._append(rows)

    def maintain(self) -> None:
        """Carries a long log over into the database, and goes on in a new file when that has grown.

        Nobody waits for it: what fails is in `error` then.
        """
        if self.error is not None or self._commits < _CHECKPOINT_AFTER:
            return
        self._commits = 0
        try:
            self._connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        except sqlite3.Error as error:
            self.error = _unwritable(error, None)
            return
        with suppress(JournalError):  # it is in `error`
            self._grow()

    def reopen(self) -> int:
        """Reads what the disk has and goes on from there, beginning with a row that says so.

        All rows that were acknowledged must be there; those of the write that failed may be.

        Returns:
            The sequence of the last row on the disk before that one. Nothing of the failed write is there if this is
            smaller than the sequence in its error, all of it otherwise.

        Raises:
            JournalError: Acknowledged rows are lost, other ones were written, or the journal still cannot be
                written. It can be tried again.
        """
        acknowledged, failed, why = self.place, self._failed, self.error
        try:
            found = self._read_again()
            kept = failed is not None and self._holds(failed)
        except (OSError, *DATABASE_ERRORS, JournalError) as error:
            self.close()
            self.error = error if isinstance(error, JournalError) else _unwritable(error, None)
            raise self.error from error
        self.place = found.place
        self._last = None if found.last is None else found.last.row
        try:
            # A commit, which also writes over what a reader elsewhere may keep of the failed one in the log.
            self._append([(row, encode_row(row)) for row in reopened_rows(found, why)])
        except JournalError:
            self.place = acknowledged
            raise
        self.error = None
        return failed.sequence if failed is not None and kept else acknowledged.sequence

    def close(self) -> None:
        """Closes the file; a transaction that failed is rolled back."""
        self._connection.close()
        self._head.close()

    def _grow(self) -> None:
        """Has a journal that has grown go on in a new file, which gets its name only when its first row is in it.

        That one rename moves the journal on. A crash before it leaves a part without a name, which nobody reads; one
        between it and the writing of the head leaves a row that the head does not name yet, as after any commit. After
        an error only `reopen` finds out in which file the journal goes on. Raises as a commit does.
        """
        if self._last is None or self._file.stat().st_size <= self._largest:
            return
        earlier, path = self._file, numbered(self._path, len(journal_files(self._path)) + 1)
        row = continued_row(self._last, earlier.name, self.place)
        (record,), place = self._chain([(row, encode_row(row))])
        self._attempts.add(place)
        try:
            failpoint("journal.before_next_file")
            make_database(path, record)
            failpoint("journal.after_next_file")
            connection = open_for_writing(path, durable=self._durable)
            self._connection.close()
            self._connection, self._file = connection, path
            self._head.write(place)
            failpoint("journal.after_next_head")
        except Exception as error:
            self._failed = place
            self.error = _unwritable(error, place.sequence)
            raise self.error from error
        self._written(place, row)

    def _written(self, place: Place, last: JournalRow | None) -> None:
        self.place, self._last, self._failed = place, last, None
        self._attempts.clear()

    def _read_again(self) -> Found:
        self.close()
        suffixes = ("", "-wal")
        parts = [path.with_name(path.name + suffix) for path in journal_files(self._path)[-2:] for suffix in suffixes]
        settle_on_disk([*parts, head_path(self._path), self._path.parent])
        found = self._open()
        if found.place not in {self.place, *self._attempts}:
            raise _foreign(self._path, self.place, found.place)
        self._connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        return found

    def _holds(self, place: Place) -> bool:
        query = "SELECT hash FROM journal WHERE sequence = ?"
        return bool(self._connection.execute(query, (place.sequence,)).fetchone() == (place.hash,))

    def _open(self) -> Found:
        """Opens what was found sound; a journal that is not is left as it is."""
        try:
            found = examine(self._path)
            if found.head is None:
                begin_head(head_path(self._path), found.key, found.place)
            if not found.version:
                make_database(self._path)
        except OSError as error:
            text = f"{self._path} cannot be opened: {error}. See to the disk, or give another cell.folder."
            raise JournalError(text, path=str(self._path)) from error
        head = found.head or Head(1, found.place)
        self._mac_key = mac_key(found.key)
        self._head = HeadFile(head_path(self._path), found.key, head, durable=self._durable)
        try:
            self._file = found.file
            self._connection = open_for_writing(found.file, durable=self._durable)
        except JournalError:
            self._head.close()
            raise
        return found

    def _take_up(self, found: Found) -> None:
        """Names in the head what a crash left unnamed there, and journals that, and that a head was begun."""
        self.place = found.place
        self._last = None if found.last is None else found.last.row
        rows = [(row, encode_row(row)) for row in note_rows(found)]
        try:
            older = 0 < found.version < VERSION
            if rows or older:
                self._append(rows, older=older)
            self._grow()  # runs that are too short for `maintain` would never do it
        except JournalError:
            self.close()
            raise

    def _append(self, rows: Sequence[Encoded], *, older: bool = False) -> int:
        attempted = self.place
        try:
            records, attempted = self._chain(rows)
            self._attempts.add(attempted)
            failpoint("journal.before_begin")
            self._connection.execute("BEGIN IMMEDIATE")
            if older:
                upgrade(self._connection)
            self._connection.executemany(INSERT, records)
            failpoint("journal.before_commit")
            self._connection.execute("COMMIT")
            failpoint("journal.after_commit")
            self._head.write(attempted)
            failpoint("journal.after_head")
        except Exception as error:  # whatever it is, those who wait must hear of it
            self._failed = self._failed or attempted
            self.error = _unwritable(error, attempted.sequence)
            raise self.error from error
        self._written(attempted, rows[-1][0] if rows else self._last)
        self._commits += 1
        return attempted.sequence

    def _chain(self, rows: Sequence[Encoded]) -> tuple[list[Record], Place]:
        sequence, previous = self.place.sequence, self.place.hash
        records: list[Record] = []
        for row, body in rows:
            sequence += 1
            own = chain_hash(previous, sequence, body)
            keys = (row.kind, row.source, row.command_id, row.branch, row.wall)
            records.append((sequence, *keys, body, previous, own, row_mac(self._mac_key, own)))
            previous = own
        return records, Place(sequence, previous)


def _unwritable(error: Exception, sequence: int | None) -> JournalError:
    return JournalError(
        f"The journal cannot be written: {error}. Nothing is acknowledged any more: see to the disk, then reopen the "
        "journal or restart.",
        sequence=sequence,
    )


def _foreign(path: Path, acknowledged: Place, found: Place) -> JournalError:
    missing = acknowledged.sequence - found.sequence
    what = f"{missing} acknowledged rows are lost" if missing > 0 else "another program has written rows"
    return JournalError(
        f"{path} ends with row {found.sequence}, and row {acknowledged.sequence} was acknowledged last: {what}. "
        "Restart the daemon in another cell.folder, and keep the files as they are.",
        path=str(path),
        missing=max(missing, 0),
        last=found.sequence,
    )
