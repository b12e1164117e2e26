"""Rows that wait together: how many one commit takes, who is answered, and what the queue refuses."""

from __future__ import annotations

import asyncio
import os
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal
from pcmrs.journal.group import MOST_WAITING
from pcmrs.journal.soundness import LARGEST_GROUP
from pcmrs.journal.writer import Encoded, JournalWriter
from pcmrs.testing.clock import settle
from tests.unit.journal.journal_rows import row


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Meanwhile whatever is written waits."""
    locker = sqlite3.connect(path, isolation_level=None)
    locker.execute("BEGIN IMMEDIATE")
    yield
    locker.execute("ROLLBACK")
    locker.close()


WITHIN = 10.0
"""A test fails when what it waits for has not come after so long, s."""


async def test_no_commit_is_larger_than_what_a_crash_may_leave_unnamed(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, sizes = JournalWriter.write, []

    def count(self: JournalWriter, rows: Any) -> int:
        sizes.append(len(rows))
        return write(self, rows)

    monkeypatch.setattr(JournalWriter, "write", count)
    journal = Journal.open(path)
    with locked(path):
        appended = [journal.append([row()] * 200) for _ in range(5)]
    assert await asyncio.gather(*appended) == [200, 400, 600, 800, 1000]
    assert max(sizes) <= LARGEST_GROUP
    assert sum(sizes) == 1000
    await journal.close()


async def test_cancelled_writer_keeps_no_other_from_its_answer(path: Path) -> None:
    journal = Journal.open(path)
    with locked(path):
        first, second, third = (asyncio.ensure_future(journal.append([row()])) for _ in range(3))
        first.cancel()
        second.cancel()
    async with asyncio.timeout(30.0):
        assert await third == 3
    await journal.close()


async def test_a_broken_journal_refuses_at_once(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    journal = Journal.open(path)
    monkeypatch.setattr(os, "pwrite", lambda *_: 0)
    with pytest.raises(JournalError):
        await journal.append([row()])
    with pytest.raises(JournalError, match="cannot be written"):
        journal.append([row()])
    assert journal.waiting == 0
    await journal.close()


async def test_error_while_reopening_does_not_end_the_writer_thread(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: JournalWriter) -> int:
        raise MemoryError

    journal = Journal.open(path)
    with monkeypatch.context() as patched:
        patched.setattr(JournalWriter, "reopen", fail)
        with pytest.raises(JournalError, match="MemoryError"):
            async with asyncio.timeout(10.0):
                await journal.reopen()
    async with asyncio.timeout(10.0):
        assert await journal.append([row()]) == 1
    await journal.close()


async def test_waiting_appends_are_committed_in_their_order(journal: Journal) -> None:
    appended = [journal.append([row(result={"number": n}), row(result={"number": -n})]) for n in range(100)]
    assert await asyncio.gather(*appended) == [2 * n + 2 for n in range(100)]
    numbers = [item.row.result["number"] for item in journal.reader.read() if item.row.result]
    assert numbers == [sign * n for n in range(100) for sign in (1, -1)]


async def test_waiting_rows_are_committed_together(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    groups: list[int] = []
    writing = threading.Event()
    write = JournalWriter.write

    def counted_write(self: JournalWriter, rows: Sequence[Encoded]) -> int:
        groups.append(len(rows))
        writing.set()
        return write(self, rows)

    monkeypatch.setattr(JournalWriter, "write", counted_write)
    journal = Journal.open(path)
    blocker = sqlite3.connect(path, isolation_level=None)
    blocker.execute("BEGIN IMMEDIATE")
    first = journal.append([row()])
    await asyncio.to_thread(writing.wait)
    waiting = [journal.append([row()]) for _ in range(50)]
    assert groups == [1]
    blocker.execute("ROLLBACK")
    blocker.close()
    assert await asyncio.gather(first, *waiting) == list(range(1, 52))
    assert groups == [1, 50]
    await journal.close()


async def test_close_waits_for_what_is_queued_and_ends_appending(journal: Journal, path: Path) -> None:
    appended = [journal.append([row()]) for _ in range(20)]
    await journal.close()
    assert await asyncio.gather(*appended) == list(range(1, 21))
    with pytest.raises(JournalError, match="closed"):
        journal.append([row()])


async def test_close_waits_for_a_commit_under_way(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write, writing, go_on = JournalWriter.write, threading.Event(), threading.Event()

    def hold_up(self: JournalWriter, rows: Sequence[Encoded]) -> int:
        writing.set()
        assert go_on.wait(WITHIN)
        return write(self, rows)

    monkeypatch.setattr(JournalWriter, "write", hold_up)
    journal = Journal.open(path)
    appended = journal.append([row()])
    assert await asyncio.to_thread(writing.wait, WITHIN)
    closing = asyncio.create_task(journal.close())
    await settle()
    assert not closing.done()
    go_on.set()
    async with asyncio.timeout(WITHIN):
        await closing
        assert await appended == 1


async def test_rows_beyond_the_queue_are_refused_and_harm_nothing(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    journal = Journal.open(path)
    locker = sqlite3.connect(path, isolation_level=None)
    locker.execute("BEGIN IMMEDIATE")
    many = [row()] * LARGEST_GROUP
    appended = [journal.append(many) for _ in range(MOST_WAITING // LARGEST_GROUP)]
    assert journal.waiting == MOST_WAITING
    with pytest.raises(JournalError, match=f"no more than {MOST_WAITING}"):
        journal.append([row()])
    with pytest.raises(JournalError, match="at once"):
        journal.append([*many, row()])
    assert journal.broken is None
    locker.execute("ROLLBACK")
    locker.close()
    assert await asyncio.gather(*appended) == list(range(LARGEST_GROUP, MOST_WAITING + 1, LARGEST_GROUP))
    assert (journal.waiting, journal.oldest_wait) == (0, 0.0)
    assert await journal.append([row()]) == MOST_WAITING + 1
    await journal.close()
