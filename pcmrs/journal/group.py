"""Group commit: one thread writes all queued rows in one transaction and waits for the disk once."""

from __future__ import annotations

import asyncio
import threading
from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

from pcmrs.clock import SystemClock
from pcmrs.errors import JournalError
from pcmrs.failpoints import failpoint
from pcmrs.journal.soundness import LARGEST_GROUP
from pcmrs.journal.writer import Encoded, JournalWriter

MOST_WAITING: Final = 4096
"""Largest number of rows that may wait for the disk; further rows are refused."""


class _Waiting(NamedTuple):
    rows: list[Encoded]
    durable: asyncio.Future[int]


class _Reopening(NamedTuple):
    reopened: asyncio.Future[int]


class GroupCommit:
    """Writer of rows in its own thread, in the order in which they were queued.

    Args:
        writer: Journal writer; from now on only the thread may use it.
        failed: Called in the caller's event loop after the writer has failed.

    Attributes:
        waiting: Number of rows that are queued or being written.
    """

    def __init__(self, writer: JournalWriter, failed: Callable[[], None]) -> None:
        self.waiting = 0
        self._failed = failed
        self._clock = SystemClock()
        self._since: deque[float] = deque()
        self._writer = writer
        self._queue: deque[_Waiting | _Reopening | None] = deque()
        self._filled = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="pcmrs-journal", daemon=True)
        self._thread.start()

    @property
    def oldest_wait(self) -> float:
        """Time that the oldest waiting row has waited, s of the machine; 0 if none waits."""
        return self._clock.monotonic() - self._since[0] if self._since else 0.0

    def append(self, rows: list[Encoded]) -> asyncio.Future[int]:
        """Queue the rows; the future returns the sequence of the last one when all are on the disk.

        Raises:
            JournalError: Too many rows wait already; nothing was queued.
        """
        if self.waiting + len(rows) > MOST_WAITING:
            raise JournalError(
                f"{self.waiting} rows have waited for the disk for up to {self.oldest_wait:.1f} s, and no more than "
                f"{MOST_WAITING} may wait: nothing is journalled until the disk answers.",
                waiting=self.waiting,
                limit=MOST_WAITING,
            )
        durable: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self.waiting += len(rows)
        self._since.append(self._clock.monotonic())
        self._put(_Waiting(rows, durable))
        return durable

    def reopen(self) -> asyncio.Future[int]:
        """Queue a reopening of the journal after the queued rows; see `JournalWriter.reopen`."""
        reopened: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self._put(_Reopening(reopened))
        return reopened

    def close(self) -> None:
        """Block until all queued rows are written, and end the thread."""
        self._put(None)
        self._thread.join()

    def _put(self, job: _Waiting | _Reopening | None) -> None:
        with self._filled:
            self._queue.append(job)
            self._filled.notify()

    def _run(self) -> None:
        while True:
            with self._filled:
                self._filled.wait_for(lambda: self._queue)
                group = self._take_group()
                job = None if group else self._queue.popleft()
            if group:
                self._commit(group)
                self._writer.maintain()
                if self._writer.error is not None:
                    group[0].durable.get_loop().call_soon_threadsafe(self._failed)
            elif isinstance(job, _Reopening):
                self._reopen(job.reopened)
            else:
                return

    def _take_group(self) -> list[_Waiting]:
        """Take the next queued rows, as many as fit into one commit."""
        group: list[_Waiting] = []
        rows = 0
        while self._queue and isinstance(first := self._queue[0], _Waiting):
            rows += len(first.rows)
            if group and rows > LARGEST_GROUP:
                break
            group.append(first)
            self._queue.popleft()
        return group

    def _commit(self, group: list[_Waiting]) -> None:
        rows = [row for waiting in group for row in waiting.rows]
        outcome: int | JournalError
        try:
            outcome = self._writer.write(rows) - len(rows)
        except JournalError as error:
            outcome = error
        failpoint("journal.before_acknowledge")
        group[0].durable.get_loop().call_soon_threadsafe(self._resolve_group, group, outcome)

    def _resolve_group(self, group: list[_Waiting], outcome: int | JournalError) -> None:
        """Give each waiter its own last sequence, counted from the last one before the group."""
        for rows, durable in group:
            self.waiting -= len(rows)
            self._since.popleft()
            if isinstance(outcome, int):
                outcome += len(rows)
            _resolve(durable, outcome)

    def _reopen(self, reopened: asyncio.Future[int]) -> None:
        outcome: int | JournalError
        try:
            outcome = self._writer.reopen()
        except JournalError as error:
            outcome = error
        except Exception as error:  # without the thread, nothing would be committed any more
            outcome = JournalError(f"The journal could not be reopened: {error!r}.")
        reopened.get_loop().call_soon_threadsafe(_resolve, reopened, outcome)


def _resolve(waiter: asyncio.Future[int], outcome: int | JournalError) -> None:
    if waiter.done():
        return
    if isinstance(outcome, int):
        waiter.set_result(outcome)
    else:
        waiter.set_exception(outcome)
