"""The journal of a running daemon: append, and wait until it is durable."""

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
    """Append-only SQLite files of facts, chained by hashes, with a signed head beside them. Use `Journal.open`.

    Attributes:
        reader: Reads what has been committed.
    """

    def __init__(self, writer: JournalWriter, reader: JournalReader, *, durable: bool) -> None:
        self.reader = reader
        self._writer = writer
        self._group = GroupCommit(writer, self._tell_of_failure) if durable else None
        self._closed = False
        self._failure_listeners: list[Callable[[JournalError], object]] = []

    @classmethod
    def open(cls, path: Path, *, durable: bool = True, largest: float = LARGEST) -> Journal:
        """Opens the journal, or makes it with its head and, in a new folder, the key pair that signs it.

        Args:
            path: Of the first file; its folder exists.
            durable: True: a thread commits, and an append ends when the disk has it. False, for simulated
                time and benchmarks: an append commits at once in the calling thread and survives a kill,
                but not a power cut.
            largest: Size beyond which the journal goes on in a new file, bytes.

        Raises:
            JournalError: The file cannot be opened, is no journal or one of another version, is open elsewhere,
                or does not hold all that its signed head names. Nothing in it was changed then.
        """
        writer = JournalWriter(path, durable=durable, largest=largest)
        return cls(writer, JournalReader(path), durable=durable)

    @property
    def broken(self) -> JournalError | None:
        """Why nothing can be appended any more, until `reopen` succeeds."""
        return self._writer.error

    def on_failure(self, callback: Callable[[JournalError], object]) -> None:
        """Has `callback` called when the journal cannot be written any more, also where no row is there to tell of it.

        A log that cannot be carried over into the database is found after the rows in it are acknowledged.
        """
        self._failure_listeners.append(callback)

    @property
    def waiting(self) -> int:
        """Rows that wait for the disk."""
        return 0 if self._group is None else self._group.waiting

    @property
    def oldest_wait(self) -> float:
        """How long the oldest of them has waited, s of the machine; 0 when none waits."""
        return 0.0 if self._group is None else self._group.oldest_wait

    def append(self, rows: Sequence[JournalRow]) -> asyncio.Future[int]:
        """Commits the rows together, after all earlier ones.

        Returns:
            To be awaited: the sequence of the last row, once the rows are durable.

        Raises:
            JournalError: At once: a row is not plain data, there are too many, too many wait for the disk, or the
                journal is closed or `broken`; nothing was written. When awaited: they could not be written; the
                error's field ``sequence`` is the one that the last row would have, or None when nothing was tried.
                Whether they are durable nevertheless, `reopen` finds out.
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
        self._tell_of_failure()
        failpoint("journal.before_acknowledge")
        committed.set_result(sequence)
        return committed

    async def reopen(self) -> int:
        """After a failed write: reads what the disk really has, and goes on from there.

        Returns:
            The sequence of the last row on the disk. An append that failed with a larger one in its error's field
            ``sequence``, or with None, is not durable; one with a smaller or the same is.

        Raises:
            JournalError: Rows that were acknowledged are lost, or the journal still cannot be written; it stays
                `broken`, and may be reopened again.
        """
        self.reader.close()  # its view of the log would outlive the failed write
        try:
            if self._group is None:
                return self._writer.reopen()
            return await self._group.reopen()
        finally:
            with suppress(JournalError):  # whoever reads hears of it
                self.reader.open()

    async def close(self) -> None:
        """Waits until everything appended is durable, then closes the file."""
        self._closed = True
        if self._group is not None:
            await asyncio.get_running_loop().run_in_executor(None, self._group.close)
        self.reader.close()  # first, since the last one to close carries the log over, and a reader cannot
        self._writer.close()

    def _tell_of_failure(self) -> None:
        if self._writer.error is not None:
            for callback in self._failure_listeners:
                callback(self._writer.error)
