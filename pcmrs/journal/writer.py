"""Writer of the journal: rows get their sequence and their position in the hash chain in one transaction."""

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
from pcmrs.journal.rows import START, JournalRow, RowPosition, chain_hash, encode_row
from pcmrs.journal.schema import DATABASE_ERRORS, INSERT, VERSION, Record, make_database, open_for_writing, upgrade
from pcmrs.journal.soundness import WritableJournal, examine

_CHECKPOINT_AFTER: Final = 200
"""Number of commits after which the write-ahead log is moved into the database, about 1000 pages."""

Encoded = tuple[JournalRow, bytes]
"""A row and its canonical bytes."""


class JournalWriter:
    """The only writer of a journal, used by one thread at a time.

    After an error it writes nothing until `reopen` has found out what is on the disk: later acknowledgements could not
    be trusted.

    Args:
        path: First file. Its folder must exist.
        durable: True to wait at each commit until it is on the disk.
        largest: Size beyond which the journal continues in a new file, bytes.

    Attributes:
        place: Position of the last row that was written, and that the head names.
        error: Reason why nothing can be written; None if the writer works.

    Raises:
        JournalError: The file cannot be opened, is not a journal or has another version, or does not hold all rows
            that its head names; see `examine`.
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
        self._failed: RowPosition | None = None
        self._attempts: set[RowPosition] = set()
        self._commits = 0
        self._adopt(self._open())

    def write(self, rows: Sequence[Encoded]) -> int:
        """Commit the rows together and return the sequence of the last one.

        Raises:
            JournalError: They cannot be written, or an earlier write failed. The field ``sequence`` is the one that
                the last row would have, None if no write was tried.
        """
        if self.error is not None:
            raise JournalError(self.error.text, sequence=None)
        return self._append(rows)

    def maintain(self) -> None:
        """Move a long write-ahead log into the database, and continue in a new file if that has grown.

        It raises nothing, since nothing waits for it: a failure is stored in `error`.
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
            self._continue_in_next_file()

    def reopen(self) -> int:
        """Continue from what is on the disk, and append a row that reports it.

        All acknowledged rows must be there; those of the failed write may be.

        Returns:
            Sequence of the last row on the disk before that row. If it is smaller than the sequence in the error of
            the failed write, nothing of that write is there; otherwise all of it is.

        Raises:
            JournalError: Acknowledged rows are lost, another program wrote rows, or the journal still cannot be
                written. You may call this again.
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
            # This commit also overwrites what a reader in another process may keep of the failed one in the log.
            self._append([(row, encode_row(row)) for row in reopened_rows(found, why)])
        except JournalError:
            self.place = acknowledged
            raise
        self.error = None
        return failed.sequence if failed is not None and kept else acknowledged.sequence

    def close(self) -> None:
        """Close the files; a failed transaction is rolled back."""
        self._connection.close()
        self._head.close()

    def _continue_in_next_file(self) -> None:
        """Continue a journal that has grown in a new file, which gets its name when its first row is in it.

        That rename is the switch. A crash before it leaves a partial file, which is never read; a crash between it
        and the write of the head leaves a row that the head does not name yet, as after any commit. After an error,
        only `reopen` finds out in which file the journal continues.

        Raises:
            JournalError: The new file or the head cannot be written.
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

    def _written(self, place: RowPosition, last: JournalRow | None) -> None:
        self.place, self._last, self._failed = place, last, None
        self._attempts.clear()

    def _read_again(self) -> WritableJournal:
        self.close()
        suffixes = ("", "-wal")
        parts = [path.with_name(path.name + suffix) for path in journal_files(self._path)[-2:] for suffix in suffixes]
        settle_on_disk([*parts, head_path(self._path), self._path.parent])
        found = self._open()
        if found.place not in {self.place, *self._attempts}:
            raise _unexpected_end(self._path, self.place, found.place)
        self._connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        return found

    def _holds(self, place: RowPosition) -> bool:
        query = "SELECT hash FROM journal WHERE sequence = ?"
        return bool(self._connection.execute(query, (place.sequence,)).fetchone() == (place.hash,))

    def _open(self) -> WritableJournal:
        """Open the journal if it is sound; otherwise leave it unchanged."""
        try:
            found = examine(self._path)
            if found.head is None:
                begin_head(head_path(self._path), found.key, found.place)
            if not found.version:
                make_database(self._path)
        except OSError as error:
            text = f"{self._path} cannot be opened: {error}. Check the disk, or give another cell.folder."
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

    def _adopt(self, found: WritableJournal) -> None:
        """Name the rows that a crash left unnamed in the head, and journal what was found."""
        self.place = found.place
        self._last = None if found.last is None else found.last.row
        rows = [(row, encode_row(row)) for row in note_rows(found)]
        try:
            older = 0 < found.version < VERSION
            if rows or older:
                self._append(rows, older=older)
            self._continue_in_next_file()  # short runs never reach the commit count of `maintain`
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
        except Exception as error:  # every error must reach those who wait
            self._failed = self._failed or attempted
            self.error = _unwritable(error, attempted.sequence)
            raise self.error from error
        self._written(attempted, rows[-1][0] if rows else self._last)
        self._commits += 1
        return attempted.sequence

    def _chain(self, rows: Sequence[Encoded]) -> tuple[list[Record], RowPosition]:
        sequence, previous = self.place.sequence, self.place.hash
        records: list[Record] = []
        for row, body in rows:
            sequence += 1
            own = chain_hash(previous, sequence, body)
            keys = (row.kind, row.source, row.command_id, row.branch, row.wall)
            records.append((sequence, *keys, body, previous, own, row_mac(self._mac_key, own)))
            previous = own
        return records, RowPosition(sequence, previous)


def _unwritable(error: Exception, sequence: int | None) -> JournalError:
    return JournalError(
        f"The journal cannot be written: {error}. Nothing is acknowledged any more: check the disk, then reopen the "
        "journal or restart.",
        sequence=sequence,
    )


def _unexpected_end(path: Path, acknowledged: RowPosition, found: RowPosition) -> JournalError:
    missing = acknowledged.sequence - found.sequence
    what = f"{missing} acknowledged rows are lost" if missing > 0 else "another program has written rows"
    return JournalError(
        f"{path} ends with row {found.sequence}, and row {acknowledged.sequence} was acknowledged last: {what}. "
        "Restart the daemon in another cell.folder, and keep the files unchanged.",
        path=str(path),
        missing=max(missing, 0),
        last=found.sequence,
    )
