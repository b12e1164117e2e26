"""The disk under a simulated daemon's journal: it can be slow, and it can fail."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalRow

FAILURE = "The journal cannot be written: the simulated disk fails."


@dataclass
class Disk:
    """What is wrong with it now.

    Attributes:
        delay: Until the next rows are durable, s.
        failing: Writes fail.
        landing: A write that fails reaches the disk all the same, as one may whose fsync has failed.
    """

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
        if not (self.disk.delay or self.disk.failing or self._under_way):
            return super().append(rows)
        loop = asyncio.get_running_loop()
        durable: asyncio.Future[int] = loop.create_future()
        self._under_way += len(rows)
        self._due = max(self._due, loop.time() + self.disk.delay)  # in the order in which they came
        loop.call_at(self._due, self._write, rows, durable)
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

    def _write(self, rows: Sequence[JournalRow], durable: asyncio.Future[int]) -> None:
        self._under_way -= len(rows)
        if self._gone or durable.done():
            return
        if self._error is not None:
            durable.set_exception(JournalError(self._error.text, sequence=None))
        elif self.disk.failing:
            self._error = JournalError(FAILURE)
            sequence = self._now(rows) if self.disk.landing else None
            durable.set_exception(JournalError(FAILURE, sequence=sequence))
        else:
            durable.set_result(self._now(rows))

    def _now(self, rows: Sequence[JournalRow]) -> int:
        """Without a simulated wait the real journal has committed when it returns."""
        written = super().append(rows)
        return written.result() if isinstance(written, asyncio.Future) else 0
