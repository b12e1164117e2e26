"""Writing the journal: rows get their sequence and their place in the hash chain in one transaction."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pcmrs.errors import JournalError
from pcmrs.journal.rows import GENESIS, JournalRow, chain_hash
from pcmrs.journal.schema import open_for_writing

_INSERT = "INSERT INTO journal VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)"

Encoded = tuple[JournalRow, bytes]
"""A row and its canonical bytes."""


class JournalWriter:
    """The one writer of a journal file, used by one thread at a time.

    After an error it writes nothing more: what is acknowledged afterwards could not be trusted.

    Args:
        path: Of the file; its folder exists.
        durable: Whether a commit waits until the disk has it.

    Raises:
        JournalError: The file cannot be opened, is no journal or one of another version.
    """

    def __init__(self, path: Path, *, durable: bool) -> None:
        self._connection = open_for_writing(path, durable=durable)
        last = self._connection.execute("SELECT sequence, hash FROM journal ORDER BY sequence DESC LIMIT 1")
        self._sequence: int
        self._hash: bytes
        self._sequence, self._hash = last.fetchone() or (0, GENESIS)
        self.error: JournalError | None = None

    def write(self, rows: Sequence[Encoded]) -> int:
        """Commits the rows together and returns the sequence of the last.

        Raises:
            JournalError: They cannot be written, or an earlier write failed.
        """
        if self.error is not None:
            raise self.error
        try:
            return self._append(rows)
        except Exception as error:  # whatever it is, those who wait must hear of it
            self.error = JournalError(
                f"The journal cannot be written: {error}. "
                "Nothing is acknowledged any more: see to the disk, then restart."
            )
            raise self.error from error

    def _append(self, rows: Sequence[Encoded]) -> int:
        sequence, previous = self._sequence, self._hash
        records = []
        for row, body in rows:
            sequence += 1
            own = chain_hash(previous, sequence, body)
            keys = (row.kind, row.source, row.command_id, row.branch, row.wall)
            records.append((sequence, *keys, body, previous, own))
            previous = own
        self._connection.execute("BEGIN IMMEDIATE")
        self._connection.executemany(_INSERT, records)
        self._connection.execute("COMMIT")
        self._sequence, self._hash = sequence, previous
        return sequence

    def close(self) -> None:
        """Closes the file; a transaction that failed is rolled back."""
        self._connection.close()
