"""The disk that holds a simulated daemon's journal. It can be slow, and it can fail."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from contextvars import Context
from dataclasses import dataclass
from pathlib import Path

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalRow

FAILURE = "The journal cannot be written: the simulated disk fails."


@dataclass
class Disk:
    """Present speed and failures of a disk.

    Attributes:
        window: Opens a window by its name and returns how long it lasts, s. A write is one window, and the
            notification of the event loop by the writer's thread is another.
        delay: Time until the next rows are durable, s.
        failing: Writes fail.
        landing: A failed write reaches the disk nevertheless, as it may after a failed fsync.
    """

    window: Callable[[str], float] = lambda _: 0.0
    delay: float = 0.0
    failing: bool = False
    landing: bool = False


class SimulatedJournal(Journal):
    """A journal that waits for a simulated disk and not for the real one. Open it with `on_disk`.

    Attributes:
        disk: Disk that holds it.
    """

    disk: Disk
    _unwritten = 0
    _write_due = 0.0
    _notify_due = 0.0
    _abandoned = False
    _error: JournalError | None = None

    @classmethod
    def on_disk(cls, path: Path, disk: Disk) -> SimulatedJournal:
        """Open the journal, or create it; see `Journal.open`.

        Args:
            path: Journal file.
            disk: Disk that holds it.

        Raises:
            JournalError: The file is not a journal, or cannot be opened.
        """
        journal = cls.open(path, durable=False)
        journal.disk = disk  # type: ignore[attr-defined]
        return journal  # type: ignore[return-value]

    @property
    def broken(self) -> JournalError | None:
        return self._error or super().broken

    @property
    def waiting(self) -> int:
        return self._unwritten

    def append(self, rows: Sequence[JournalRow]) -> asyncio.Future[int]:
        if self._abandoned:
            raise JournalError("The daemon is gone: nothing can be appended.", sequence=None)
        if self._error is not None:
            raise JournalError(self._error.text, sequence=None)
        name = _name_of(rows)
        write_time, notify_time = self.disk.window(f"write:{name}"), self.disk.window(f"written:{name}")
        loop = asyncio.get_running_loop()
        # A row that needs no wait must not overtake earlier ones: the real writer's queue keeps their order.
        queued = self._unwritten or self._notify_due > loop.time()
        if not (self.disk.delay or self.disk.failing or queued or write_time or notify_time):
            return super().append(rows)
        durable: asyncio.Future[int] = loop.create_future()
        self._unwritten += len(rows)
        self._write_due = max(self._write_due, loop.time() + self.disk.delay + write_time)
        # An empty context belongs to no process, as the writer's thread does not: a stalled loop does not delay it.
        loop.call_at(self._write_due, self._write, rows, durable, notify_time, context=Context())
        return durable

    async def reopen(self) -> int:
        if self.disk.failing:
            raise JournalError(FAILURE)
        self._error = None
        return next((stored.sequence for stored in self.reader.read(last=1)), 0)

    async def close(self) -> None:
        """Close the journal. Unless it was abandoned, pending rows are written first."""
        if self._unwritten and not self._abandoned:
            await asyncio.sleep(self._write_due - asyncio.get_running_loop().time())
        await super().close()

    def abandon(self) -> None:
        """Drop all rows that are not durable yet, as the death of the daemon does."""
        self._abandoned = True

    def _write(self, rows: Sequence[JournalRow], durable: asyncio.Future[int], notify_time: float) -> None:
        self._unwritten -= len(rows)
        if self._abandoned:
            return
        sequence: int | None = None
        if self._error is None and self.disk.failing:
            self._error = JournalError(FAILURE)
            sequence = self._commit(rows) if self.disk.landing else None
        elif self._error is None:
            sequence = self._commit(rows)
        error = None if self._error is None else JournalError(self._error.text, sequence=sequence)
        loop = asyncio.get_running_loop()
        # The writer's thread notifies the loop in the order of its writes.
        self._notify_due = max(self._notify_due, loop.time() + notify_time)
        if self._notify_due > loop.time():
            loop.call_at(self._notify_due, self._notify, durable, error, sequence, context=Context())
        else:
            self._notify(durable, error, sequence)

    def _notify(self, durable: asyncio.Future[int], error: JournalError | None, sequence: int | None) -> None:
        if self._abandoned or durable.done():
            return
        if error is not None:
            durable.set_exception(error)
        else:
            durable.set_result(sequence or 0)

    def _commit(self, rows: Sequence[JournalRow]) -> int:
        """Commit rows to the real journal, which is done when the call returns; return the last sequence number."""
        written = super().append(rows)
        return written.result() if isinstance(written, asyncio.Future) else 0


def _name_of(rows: Sequence[JournalRow]) -> str:
    """Return the name of the first row, such as ``outcome:placement.back_off`` or ``device:reference_moved``."""
    row = rows[0]
    return f"{row.kind}:{row.branch}.{row.operation}" if row.branch else f"{row.kind}:{row.operation or ''}"
