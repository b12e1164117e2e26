"""The disk under a simulated daemon's journal: it can be slow, and it can fail."""

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
    """What is wrong with it now.

    Attributes:
        window: Opens a window by its name and tells how long it lasts, s: a write, and the way back from its thread.
        delay: Until the next rows are durable, s.
        failing: Writes fail.
        landing: A write that fails reaches the disk all the same, as one may whose fsync has failed.
    """

    window: Callable[[str], float] = lambda _: 0.0
    delay: float = 0.0
    failing: bool = False
    landing: bool = False


class SimulatedJournal(Journal):
    """A journal that does not wait for the real disk, but for a simulated one; use `on_disk`.

    Attributes:
        disk: Under it.
    """

    disk: Disk
    _under_way = 0
    _due = 0.0
    _back = 0.0
    _gone = False
    _error: JournalError | None = None

    @classmethod
    def on_disk(cls, path: Path, disk: Disk) -> SimulatedJournal:
        """Opens the journal, or makes it; see `Journal.open`."""
        journal = cls.open(path, durable=False)
        journal.disk = disk  # type: ignore[attr-defined]
        return journal  # type: ignore[return-value]

    @property
    def broken(self) -> JournalError | None:
        return self._error or super().broken

    @property
    def waiting(self) -> int:
        return self._under_way

    def append(self, rows: Sequence[JournalRow]) -> asyncio.Future[int]:
        if self._gone:
            raise JournalError("The daemon is gone: nothing can be appended.", sequence=None)
        if self._error is not None:
            raise JournalError(self._error.text, sequence=None)
        name = _name_of(rows)
        writing, back = self.disk.window(f"write:{name}"), self.disk.window(f"written:{name}")
        loop = asyncio.get_running_loop()
        queued = self._under_way or self._back > loop.time()  # nobody learns of a later row first
        if not (self.disk.delay or self.disk.failing or queued or writing or back):
            return super().append(rows)
        durable: asyncio.Future[int] = loop.create_future()
        self._under_way += len(rows)
        self._due = max(self._due, loop.time() + self.disk.delay + writing)  # in the order in which they came
        loop.call_at(self._due, self._write, rows, durable, back, context=Context())  # by the writer's thread
        return durable

    async def reopen(self) -> int:
        if self.disk.failing:
            raise JournalError(FAILURE)
        self._error = None
        return next((stored.sequence for stored in self.reader.read(last=1)), 0)

    async def close(self) -> None:
        """Closes it, in an orderly end when what is under way has been written."""
        if self._under_way and not self._gone:
            await asyncio.sleep(self._due - asyncio.get_running_loop().time())
        await super().close()

    def abandon(self) -> None:
        """The daemon is gone: what is not durable never will be."""
        self._gone = True

    def _write(self, rows: Sequence[JournalRow], durable: asyncio.Future[int], back: float) -> None:
        self._under_way -= len(rows)
        if self._gone:
            return
        sequence: int | None = None
        if self._error is None and self.disk.failing:
            self._error = JournalError(FAILURE)
            sequence = self._now(rows) if self.disk.landing else None
        elif self._error is None:
            sequence = self._now(rows)
        error = None if self._error is None else JournalError(self._error.text, sequence=sequence)
        loop = asyncio.get_running_loop()
        self._back = max(self._back, loop.time() + back)  # the loop is told in the same order
        if self._back > loop.time():
            loop.call_at(self._back, self._tell, durable, error, sequence, context=Context())
        else:
            self._tell(durable, error, sequence)

    def _tell(self, durable: asyncio.Future[int], error: JournalError | None, sequence: int | None) -> None:
        if self._gone or durable.done():
            return
        if error is not None:
            durable.set_exception(error)
        else:
            durable.set_result(sequence or 0)

    def _now(self, rows: Sequence[JournalRow]) -> int:
        """Without a simulated wait the real journal has committed when it returns."""
        written = super().append(rows)
        return written.result() if isinstance(written, asyncio.Future) else 0


def _name_of(rows: Sequence[JournalRow]) -> str:
    """Of the first row, such as ``outcome:placement.back_off`` or ``device:reference_moved``."""
    row = rows[0]
    return f"{row.kind}:{row.branch}.{row.operation}" if row.branch else f"{row.kind}:{row.operation or ''}"
