"""The journal of a running daemon: append, and wait until it is durable."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Sequence
from pathlib import Path

from pcmrs.errors import JournalError
from pcmrs.journal.group import GroupCommit
from pcmrs.journal.reader import JournalReader
from pcmrs.journal.rows import JournalRow, encode_row
from pcmrs.journal.writer import JournalWriter


class Journal:
    """An append-only SQLite file of facts, chained by hashes. Use `Journal.open`.

    Attributes:
        reader: Reads what has been committed.
    """

    def __init__(self, writer: JournalWriter, group: GroupCommit | None, reader: JournalReader) -> None:
        self.reader = reader
        self._writer = writer
        self._group = group
        self._closed = False

    @classmethod
    def open(cls, path: Path, *, durable: bool = True) -> Journal:
        """Opens the journal, or makes it.

        Args:
            path: Of the file; its folder exists.
            durable: True: a thread commits, and an append ends when the disk has it. False, for simulated
                time and benchmarks: an append commits at once in the calling thread and survives a kill,
                but not a power cut.

        Raises:
            JournalError: The file cannot be opened, is no journal or one of another version.
        """
        writer = JournalWriter(path, durable=durable)
        return cls(writer, GroupCommit(writer) if durable else None, JournalReader(path))

    def append(self, rows: Sequence[JournalRow]) -> Awaitable[int]:
        """Commits the rows together, after all earlier ones.

        Returns:
            To be awaited: the sequence of the last row, once the rows are durable.

        Raises:
            JournalError: At once or when awaited: a row is not plain data, the journal is closed, or it
                cannot be written. After a failed write every append raises.
        """
        if self._closed:
            raise JournalError("The journal is closed: nothing can be appended.")
        if self._writer.error is not None:
            raise self._writer.error
        encoded = [(row, encode_row(row)) for row in rows]
        if self._group is not None:
            return self._group.append(encoded)
        committed: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        committed.set_result(self._writer.write(encoded))
        return committed

    async def close(self) -> None:
        """Waits until everything appended is durable, then closes the file."""
        self._closed = True
        if self._group is not None:
            await asyncio.get_running_loop().run_in_executor(None, self._group.close)
        self._writer.close()
        self.reader.close()
