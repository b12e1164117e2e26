"""Writing: nothing has its name before the disk has it, and what the disk really has is found out after an error."""

from __future__ import annotations

import asyncio
import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest

from pcmrs.errors import JournalError
from pcmrs.files import settle_on_disk, write_durably
from pcmrs.journal import Journal, JournalReader, schema, verify
from pcmrs.journal.chain import mac_key, row_mac
from pcmrs.journal.keys import signing_key
from pcmrs.journal.rows import chain_hash, encode_row
from pcmrs.journal.writer import JournalWriter
from tests.unit.journal.journal_rows import ROW, intent, row
from tests.unit.journal.whole_journal import name_of


@pytest.fixture
def synced(path: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, set[str]]]:
    """What the disk was asked to take, by its name, and what was in the folder then."""
    calls: list[tuple[str, set[str]]] = []
    sync = os.fsync

    def spy(descriptor: int) -> None:
        sync(descriptor)
        calls.append((name_of(descriptor), {each.name for each in path.parent.iterdir()}))

    monkeypatch.setattr(os, "fsync", spy)
    return calls


@contextmanager
def locked_by_another(path: Path) -> Iterator[None]:
    """Another process writes to the journal, and is not ready."""
    with closing(sqlite3.connect(path, isolation_level=None)) as locker:
        locker.execute("BEGIN IMMEDIATE")
        yield
        locker.execute("ROLLBACK")


@pytest.mark.parametrize("name", ["journal.key", "journal.pub", "journal.sqlite", "journal.sqlite.head"])
def test_file_is_synchronised_before_and_after_it_gets_its_name(
    path: Path, synced: list[tuple[str, set[str]]], name: str
) -> None:
    JournalWriter(path, durable=True).close()
    as_part = [number for number, (what, there) in enumerate(synced) if what == f"{name}.part" and name not in there]
    named = [number for number, (what, there) in enumerate(synced) if what == path.parent.name and name in there]
    assert len(as_part) == 1
    assert as_part[0] + 1 in named


def test_failed_write_leaves_no_file(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="No space"):
        write_durably(path, b"content", mode=0o600)
    assert list(path.parent.iterdir()) == []


def test_reads_after_a_failure_come_from_the_disk(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel forgets that it could not write, and shows what it would have written."""
    asked: list[tuple[str, str]] = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: asked.append(("take", name_of(descriptor))))
    monkeypatch.setattr(os, "posix_fadvise", lambda descriptor, *_: asked.append(("forget", name_of(descriptor))))
    path.write_bytes(b"content")
    settle_on_disk([path, path.with_name("missing")])
    assert asked == [("take", path.name), ("forget", path.name)]


def test_reopening_settles_all_files(path: Path, synced: list[tuple[str, set[str]]]) -> None:
    writer = JournalWriter(path, durable=True)
    writer.write([ROW])
    synced.clear()
    writer.reopen()
    writer.close()
    settled = {path.name, f"{path.name}.head", path.parent.name}
    assert {name for name, _ in synced} == settled, "the log is gone when all is closed"


def test_unacknowledged_row_may_be_gone_at_the_second_reopening(path: Path) -> None:
    """It was on the disk when the first one failed, and the disk has lost it since."""
    writer = JournalWriter(path, durable=True)
    writer.write([ROW])
    writer.close()
    kept = {each: each.read_bytes() for each in path.parent.iterdir()}
    writer = JournalWriter(path, durable=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "pwrite", lambda *_: 0)
        with pytest.raises(JournalError):
            writer.write([ROW])
        with pytest.raises(JournalError):
            writer.reopen()
    path.with_name(f"{path.name}-wal").write_bytes(b"")
    for each, content in kept.items():
        each.write_bytes(content)
    assert writer.reopen() == 1
    writer.close()


@pytest.mark.parametrize("durable", [True, False])
async def test_after_a_failed_write_nothing_is_acknowledged(path: Path, durable: bool) -> None:
    journal = Journal.open(path, durable=durable)
    await journal.append([intent("a")])
    with pytest.raises(JournalError, match="cannot be written"):
        # The same command cannot have two intents.
        await journal.append([row(), intent("a")])
    for _ in range(2):
        with pytest.raises(JournalError, match="Nothing is acknowledged"):
            await journal.append([row()])
    await journal.close()
    with JournalReader(path) as reader:
        assert [stored.sequence for stored in reader.read()] == [1]


@pytest.mark.parametrize("durable", [True, False])
async def test_an_error_that_is_not_sqlite_s_ends_the_journal_too(path: Path, durable: bool) -> None:
    journal = Journal.open(path, durable=durable)
    too_large = msgspec.structs.replace(row(), wall=2**63)  # for a column of SQLite, though not for MessagePack
    for appended in (too_large, row(), row()):
        with pytest.raises(JournalError, match="Nothing is acknowledged"):
            await journal.append([appended])
    await journal.close()


async def test_a_lock_of_another_process_ends_it_until_it_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(schema, "LOCK_TIMEOUT", 0.05)
    path = tmp_path / "journal.sqlite"
    journal = Journal.open(path)
    await journal.append([row()])
    with locked_by_another(path):
        with pytest.raises(JournalError, match="locked"):
            await journal.append([row()])
        with pytest.raises(JournalError, match="locked"):
            await journal.reopen()
        assert journal.broken is not None
        assert [stored.sequence for stored in journal.reader.read()] == [1]
    assert await journal.reopen() == 1
    assert journal.broken is None
    assert [stored.row.operation for stored in journal.reader.read(source="journal")] == ["reopened"]
    assert await journal.append([row()]) == 3
    await journal.close()


async def test_journal_whose_first_write_failed_starts_with_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is no row yet whose session a row about the failure could belong to."""
    monkeypatch.setattr(schema, "LOCK_TIMEOUT", 0.05)
    path = tmp_path / "journal.sqlite"
    journal = Journal.open(path)
    with locked_by_another(path), pytest.raises(JournalError, match="locked"):
        await journal.append([row()])
    assert await journal.reopen() == 0
    assert journal.broken is None
    assert await journal.append([row(result={"first": True})]) == 1
    assert [stored.row.result for stored in journal.reader.read()] == [{"first": True}]
    await journal.close()
    assert verify(path).sound


@pytest.mark.parametrize("durable", [True, False])
@pytest.mark.parametrize(
    ("chained", "with_key", "word"),
    [
        (False, False, "row 2"),
        (True, False, "It was written without the key"),
        (True, True, "another program has written rows"),
    ],
)
async def test_rows_of_another_program_are_not_taken_for_own_ones(
    tmp_path: Path, durable: bool, chained: bool, with_key: bool, word: str
) -> None:
    path = tmp_path / "journal.sqlite"
    journal = Journal.open(path, durable=durable)
    await journal.append([row()])
    (own,) = journal.reader.read()
    body = encode_row(own.row)
    forged = chain_hash(own.hash, 2, body) if chained else own.hash
    mac = row_mac(mac_key(signing_key(tmp_path, make=False)), forged) if with_key else None
    foreign = sqlite3.connect(path)
    with foreign:
        record = (2, "event", None, None, None, own.row.wall, body, own.hash, forged, mac)
        foreign.execute("INSERT INTO journal VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", record)
    foreign.close()
    with pytest.raises(JournalError, match="no gaps"):
        await journal.append([row(result={"mine": True})])
    for _ in range(2):
        with pytest.raises(JournalError, match=word):
            await journal.reopen()
    assert journal.broken is not None
    await journal.close()


async def test_acknowledged_rows_missing_on_disk_are_reported_as_lost(tmp_path: Path) -> None:
    path, kept = tmp_path / "journal.sqlite", tmp_path / "kept"
    journal = Journal.open(path)
    await journal.append([row()] * 2)
    await journal.close()
    kept.write_bytes(path.read_bytes())
    journal = Journal.open(path)
    await journal.append([row()] * 3)
    path.write_bytes(kept.read_bytes())  # the disk brings back what it had
    path.with_name(path.name + "-wal").write_bytes(b"")
    with pytest.raises(JournalError, match="3 acknowledged rows are lost"):
        await journal.reopen()
    assert journal.broken is not None
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
