"""Rows that wait together: how many one commit takes, who hears of it, and that nothing follows an error."""

from __future__ import annotations

import asyncio
import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal
from pcmrs.journal.rows import encode_row
from pcmrs.journal.soundness import LARGEST_GROUP
from pcmrs.journal.writer import JournalWriter
from tests.unit.journal.journal_rows import row


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "journal.sqlite"


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Meanwhile whatever is written waits."""
    locker = sqlite3.connect(path, isolation_level=None)
    locker.execute("BEGIN IMMEDIATE")
    yield
    locker.execute("ROLLBACK")
    locker.close()


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


def test_rows_queued_behind_an_error_are_not_written(path: Path) -> None:
    """Not even where the disk takes it again: only a reopening finds out what it has."""
    writer, rows = JournalWriter(path, durable=True), [(row(), encode_row(row()))]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "pwrite", lambda *_: 0)
        with pytest.raises(JournalError):
            writer.write(rows)
    with pytest.raises(JournalError) as refused:
        writer.write(rows)
    assert refused.value.fields["sequence"] is None
    assert writer.reopen() == 1
    assert writer.write(rows) == 3
    writer.close()


@pytest.mark.parametrize(
    "value",
    ["\ud800", 2**70, -(2**70), object(), {1: {2: object()}}],
    ids=["surrogate", "large", "small", "object", "nested object"],
)
def test_value_that_a_row_cannot_hold_is_refused(value: object) -> None:
    with pytest.raises(JournalError, match="cannot be journalled"):
        encode_row(row(result={"value": value}))


def test_value_that_contains_itself_is_refused() -> None:
    endless: list[object] = []
    endless.append(endless)
    with pytest.raises(JournalError, match="cannot be journalled"):
        encode_row(row(result={"value": endless}))


@pytest.mark.parametrize(("pragma", "instead"), [("synchronous", "1"), ("journal_mode", "DELETE")])
def test_a_disk_that_cannot_be_waited_for_is_refused(
    path: Path, monkeypatch: pytest.MonkeyPatch, pragma: str, instead: str
) -> None:
    """Some network file systems know no such log, and builds of SQLite may be set otherwise."""

    class Deaf(sqlite3.Connection):
        def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
            return super().execute(
                f"PRAGMA {pragma} = {instead}" if sql.startswith(f"PRAGMA {pragma} =") else sql, *values
            )

    JournalWriter(path, durable=True).close()
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *where, **how: connect(*where, factory=Deaf, **how))
    with pytest.raises(JournalError, match="cannot be written safely"):
        JournalWriter(path, durable=True)


@pytest.mark.parametrize("durable", [True, False])
async def test_failed_checkpoint_is_reported_even_without_more_writes(
    path: Path, monkeypatch: pytest.MonkeyPatch, durable: bool
) -> None:
    class Failing(sqlite3.Connection):
        def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
            if sql.startswith("PRAGMA wal_checkpoint"):
                raise sqlite3.OperationalError("disk I/O error")
            return super().execute(sql, *values)

    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda *where, **how: connect(*where, factory=Failing, **how))
    monkeypatch.setattr("pcmrs.journal.writer._CHECKPOINT_AFTER", 1)
    journal = Journal.open(path, durable=durable)
    told: asyncio.Queue[str] = asyncio.Queue()
    journal.on_failure(lambda error: told.put_nowait(error.text))
    async with asyncio.timeout(10.0):
        assert await journal.append([row()]) == 1
        assert "disk I/O error" in await told.get()
    await journal.close()


@pytest.mark.parametrize("durable", [True, False])
def test_only_the_writer_carries_the_log_over(path: Path, durable: bool) -> None:
    """SQLite would keep an error of the disk to itself."""
    writer = JournalWriter(path, durable=durable)
    assert writer._connection.execute("PRAGMA wal_autocheckpoint").fetchone() == (0,)
    writer.close()


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
