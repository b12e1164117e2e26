"""The journal of a running daemon: append rows, and wait until they are durable."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from pcmrs.errors import JournalError
from pcmrs.failpoints import failpoint
from pcmrs.journal.group import GroupCommit
from pcmrs.journal.reader import LARGEST, JournalReader
from pcmrs.journal.rows import JournalRow, encode_row
from pcmrs.journal.soundness import LARGEST_GROUP
from pcmrs.journal.writer import JournalWriter


class Journal:
    """Append-only SQLite files of rows, chained by hashes, with a signed head beside them. Use `Journal.open`.

    Args:
        writer: Writer of the files, open.
        reader: Reader of the same files.
        durable: See `Journal.open`.

    Attributes:
        reader: Reader of the committed rows.
    """

    def __init__(self, writer: JournalWriter, reader: JournalReader, *, durable: bool) -> None:
        self.reader = reader
        self._writer = writer
        self._group = GroupCommit(writer, self._report_failure) if durable else None
        self._closed = False
        self._failure_listeners: list[Callable[[JournalError], object]] = []

    @classmethod
    def open(cls, path: Path, *, durable: bool = True, largest: float = LARGEST) -> Journal:
        """Open the journal, or create it with its head and, in a new folder, the key pair that signs it.

        Args:
            path: First file. Its folder must exist.
            durable: True to commit in a thread; an append then ends when the rows are on the disk. False, for
                simulated time and benchmarks, to commit at once in the calling thread: rows survive a kill of the
                process, but not a power cut.
            largest: Size beyond which the journal continues in a new file, bytes.

        Raises:
            JournalError: The file cannot be opened, is not a journal or has another version, is open elsewhere,
                or does not hold all rows that its signed head names. Nothing in it was changed.
        """
        writer = JournalWriter(path, durable=durable, largest=largest)
        return cls(writer, JournalReader(path), durable=durable)

    @property
    def broken(self) -> JournalError | None:
        """Reason why nothing can be appended until `reopen` succeeds; None if the journal works."""
        return self._writer.error

    def on_failure(self, callback: Callable[[JournalError], object]) -> None:
        """Register a callback for a failure of the journal, also for one that no append reports.

        SQLite moves its write-ahead log into the database after the rows in it are acknowledged: an error there
        belongs to no append.
        """
        self._failure_listeners.append(callback)

    @property
    def waiting(self) -> int:
        """Number of rows that wait for the disk."""
        return 0 if self._group is None else self._group.waiting

    @property
    def oldest_wait(self) -> float:
        """Time that the oldest of them has waited, s of the machine; 0 if none waits."""
        return 0.0 if self._group is None else self._group.oldest_wait

    def append(self, rows: Sequence[JournalRow]) -> asyncio.Future[int]:
        """Commit the rows together, after all earlier ones.

        Returns:
            Future of the sequence of the last row, done when the rows are durable.

        Raises:
            JournalError: At once: a row is not plain data, there are too many rows, too many wait for the disk, or
                the journal is closed or `broken`; nothing was written. From the future: the rows could not be
                written; the field ``sequence`` is the one that the last row would have, or None if no write was
                tried. `reopen` finds out whether they are durable nevertheless.
        """
        if self._closed:
            raise JournalError("The journal is closed: nothing can be appended.")
        if self._writer.error is not None:
            raise JournalError(self._writer.error.text, sequence=None)
        if len(rows) > LARGEST_GROUP:
            text = f"{len(rows)} rows cannot be journalled at once: {LARGEST_GROUP} at most."
            raise JournalError(text, rows=len(rows), limit=LARGEST_GROUP)
        encoded = [(row, encode_row(row)) for row in rows]
        if self._group is not None:
            return self._group.append(encoded)
        committed: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        sequence = self._writer.write(encoded)
        self._writer.maintain()
        self._report_failure()
        failpoint("journal.before_acknowledge")
        committed.set_result(sequence)
        return committed

    async def reopen(self) -> int:
        """Continue after a failed write from what is really on the disk.

        Returns:
            Sequence of the last row on the disk. An append whose error has a larger one in its field ``sequence``,
            or None, is not durable; one with a smaller or equal one is.

        Raises:
            JournalError: Acknowledged rows are lost, or the journal still cannot be written; it stays `broken`, and
                you may call this again.
        """
        self.reader.close()  # it would keep the log as it was before the failed write
        try:
            if self._group is None:
                return self._writer.reopen()
            return await self._group.reopen()
        finally:
            with suppress(JournalError):  # the next read reports it
                self.reader.open()

    async def close(self) -> None:
        """Wait until all appended rows are durable, and close the file."""
        self._closed = True
        if self._group is not None:
            await asyncio.get_running_loop().run_in_executor(None, self._group.close)
        self.reader.close()  # first: the last connection to close empties the log, and a reader cannot
        self._writer.close()

    def _report_failure(self) -> None:
        if self._writer.error is not None:
            for callback in self._failure_listeners:
                callback(self._writer.error)
