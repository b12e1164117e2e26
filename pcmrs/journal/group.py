"""Group commit: one thread writes whatever waits, with one wait for the disk."""

from __future__ import annotations

import asyncio
import queue
import threading
from typing import NamedTuple

from pcmrs.errors import JournalError
from pcmrs.journal.writer import Encoded, JournalWriter


class _Waiting(NamedTuple):
    rows: list[Encoded]
    durable: asyncio.Future[int]


class GroupCommit:
    """Writes rows in a thread of its own, in the order in which they were queued.

    Args:
        writer: Used by the thread only from now on.
    """

    def __init__(self, writer: JournalWriter) -> None:
        self._writer = writer
        self._queue: queue.SimpleQueue[_Waiting | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="pcmrs-journal", daemon=True)
        self._thread.start()

    def append(self, rows: list[Encoded]) -> asyncio.Future[int]:
        """Queues the rows; the future has the sequence of the last once the disk has them all."""
        durable: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self._queue.put(_Waiting(rows, durable))
        return durable

    def close(self) -> None:
        """Blocks until everything queued is written."""
        self._queue.put(None)
        self._thread.join()

    def _run(self) -> None:
        while True:
            taken = self._take()
            group = [waiting for waiting in taken if waiting is not None]
            if group:
                self._commit(group)
            if len(group) < len(taken):
                return

    def _take(self) -> list[_Waiting | None]:
        taken = [self._queue.get()]
        while not self._queue.empty():
            taken.append(self._queue.get())
        return taken

    def _commit(self, group: list[_Waiting]) -> None:
        rows = [row for waiting in group for row in waiting.rows]
        outcome: int | JournalError
        try:
            outcome = self._writer.write(rows) - len(rows)
        except JournalError as error:
            outcome = error
        group[0].durable.get_loop().call_soon_threadsafe(_settle, group, outcome)


def _settle(group: list[_Waiting], outcome: int | JournalError) -> None:
    """Tells every waiter its own last sequence, counted on from the last one before the group."""
    for rows, durable in group:
        if isinstance(outcome, int):
            outcome += len(rows)
        if durable.done():
            continue
        if isinstance(outcome, int):
            durable.set_result(outcome)
        else:
            durable.set_exception(outcome)
