"""Journal: order, the hash chain, what cannot be done to it, and how it fails."""

import asyncio
import hashlib
import sqlite3
import threading
from collections.abc import AsyncIterator, Iterable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, StoredRow
from pcmrs.journal.rows import GENESIS, decode_row, encode_row
from pcmrs.journal.writer import Encoded, JournalWriter
from pcmrs.testing.clock import settle
from tests.unit.journal.journal_rows import intent, outcome, row

WITHIN = 10.0
"""A test fails when what it waits for has not come after so long, s."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "journal.sqlite"


@pytest.fixture(params=[True, False], ids=["durable", "inline"])
async def journal(request: pytest.FixtureRequest, path: Path) -> AsyncIterator[Journal]:
    journal = Journal.open(path, durable=request.param)
    yield journal
    await journal.close()


async def test_rows_come_back_in_order_without_gaps(journal: Journal) -> None:
    rows = [intent("a"), outcome("a"), row("device", result={"code": "link_lost"})]
    assert await journal.append(rows[:2]) == 2
    assert await journal.append(rows[2:]) == 3
    stored = list(journal.reader.read())
    assert [item.row for item in stored] == rows
    assert [item.sequence for item in stored] == [1, 2, 3]


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


async def test_the_chain_continues_over_a_restart(path: Path) -> None:
    for part in range(3):
        journal = Journal.open(path, durable=part != 1)
        await journal.append([row(result={"part": part}), row()])
        await journal.close()
    with JournalReader(path) as reader:
        previous = GENESIS
        for number, stored in enumerate(reader.read(), start=1):
            body = encode_row(stored.row)
            assert stored.sequence == number
            assert stored.previous_hash == previous
            previous = hashlib.sha256(previous + number.to_bytes(8, "big") + body).digest()
            assert stored.hash == previous
    assert number == 6


@given(st.permutations(["a", "b", "c", "d"]))
def test_the_encoding_does_not_depend_on_the_order_of_keys(keys: list[str]) -> None:
    mixed = row(arguments={key: dict.fromkeys(keys, 1) for key in keys})
    ordered = row(arguments={key: dict.fromkeys(sorted(keys), 1) for key in sorted(keys)})
    assert encode_row(mixed) == encode_row(ordered)


plain = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@given(st.dictionaries(st.text(), plain, max_size=3))
def test_rows_survive_their_encoding(arguments: dict[str, object]) -> None:
    original = row(arguments=arguments, states={"robot": "1"})
    assert decode_row(encode_row(original)) == original


@pytest.mark.parametrize(
    "statement",
    [
        "UPDATE journal SET wall = 0 WHERE sequence = 1",
        "UPDATE journal SET body = x'00' WHERE sequence = 1",
        "UPDATE journal SET sequence = 9 WHERE sequence = 2",
        "DELETE FROM journal WHERE sequence = 2",
        "DELETE FROM journal",
        "INSERT INTO journal SELECT sequence + 5, kind, 's', 'i', '', 0, body, hash, hash, mac FROM journal LIMIT 1",
        "INSERT OR REPLACE INTO journal SELECT sequence, 'event', 's', 'i', '', 0, body, hash, hash, mac FROM journal",
    ],
)
async def test_rows_can_be_neither_changed_nor_removed(journal: Journal, path: Path, statement: str) -> None:
    await journal.append([intent("a"), outcome("a")])
    before = list(journal.reader.read())
    other = sqlite3.connect(path, isolation_level=None)
    with pytest.raises(sqlite3.IntegrityError):
        other.execute(statement)
    other.close()
    assert list(journal.reader.read()) == before


async def test_the_recorded_verdict_outlives_a_restart(path: Path) -> None:
    journal = Journal.open(path, durable=False)
    await journal.append([intent("a", "udp:planner"), outcome("a", "udp:planner"), intent("b", "udp:planner")])
    await journal.close()
    journal = Journal.open(path, durable=False)
    assert journal.reader.verdict_of("udp:planner", "a") == outcome("a").verdict
    assert journal.reader.verdict_of("udp:planner", "b") is None
    assert journal.reader.verdict_of("bus:local", "a") is None
    await journal.close()


async def test_reading_can_be_narrowed(journal: Journal) -> None:
    await journal.append([intent("a"), outcome("a"), row("device"), intent("b", "udp:x")])
    read = journal.reader.read

    def sequences(rows: Iterable[StoredRow]) -> list[int]:
        return [stored.sequence for stored in rows]

    assert sequences(read(kind="intent")) == [1, 4]
    assert sequences(read(branch="registration", after=1)) == [2, 4]
    assert sequences(read(source="udp:x")) == [4]
    assert sequences(read(command_id="a")) == [1, 2]
    assert sequences(read(last=2)) == [3, 4]
    assert sequences(read(first=2)) == [1, 2]
    assert sequences(read(first=1, last=2)) == [3]
    assert sequences(read(after=2, first=1)) == [3]
    assert sequences(read(branch="registration", last=2)) == [2, 4]


async def test_first_rows_cost_the_same_in_a_long_and_a_short_journal(path: Path) -> None:
    journal = Journal.open(path, durable=False)

    def cost() -> int:
        """Steps of SQLite's machine for five rows."""
        steps: list[None] = []
        journal.reader._files[-1][1].set_progress_handler(lambda: steps.append(None), 1)
        assert [stored.sequence for stored in journal.reader.read(after=3, first=5)] == [4, 5, 6, 7, 8]
        journal.reader._files[-1][1].set_progress_handler(None, 1)
        return len(steps)

    await journal.append([row()] * 20)
    short = cost()
    for _ in range(10):
        await journal.append([row()] * 200)
    assert cost() <= short  # the first one reads the schema as well
    await journal.close()


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


async def test_a_row_that_is_no_data_is_refused_and_harms_nothing(journal: Journal) -> None:
    with pytest.raises(JournalError, match="cannot be journalled"):
        journal.append([row(arguments={"pose": object()})])
    assert await journal.append([row()]) == 1


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


async def test_reading_continues_while_a_daemon_writes(path: Path) -> None:
    journal = Journal.open(path)
    with JournalReader(path) as reader:
        for number in range(1, 6):
            await journal.append([row()])
            assert [stored.sequence for stored in reader.read()] == list(range(1, number + 1))
        rows = reader.read()
        next(rows)
        # A half-read listing keeps its view and holds nobody up.
        await journal.append([row()])
        assert len(list(rows)) == 4
    await journal.close()


@pytest.mark.parametrize("content", [b"", b"not a database at all, just some text" * 40])
def test_a_file_that_is_no_journal_cannot_be_read(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(JournalError, match="another file"):
        JournalReader(path)


def test_a_missing_or_foreign_file_is_refused(path: Path) -> None:
    with pytest.raises(JournalError):
        JournalReader(path)
    foreign = sqlite3.connect(path)
    foreign.execute("CREATE TABLE somebody_elses (x)")
    foreign.close()
    before = path.read_bytes()
    with pytest.raises(JournalError, match="version 0"):
        Journal.open(path)
    assert path.read_bytes() == before
    with pytest.raises(JournalError, match="cannot be used"):
        Journal.open(path.parent / "no such folder" / "journal.sqlite")


@pytest.mark.parametrize("query", ["FROM kept", "FROM kept UNION ALL SELECT * FROM kept"])
async def test_rows_that_a_query_makes_are_no_journal(path: Path, query: str) -> None:
    """A view can make rows without end; nothing is asked of one."""
    journal = Journal.open(path)
    await journal.append([row()])
    await journal.close()
    with closing(sqlite3.connect(path)) as connection:
        connection.execute("ALTER TABLE journal RENAME TO kept")
        connection.execute(f"CREATE VIEW journal AS SELECT * {query}")
        connection.commit()
    with pytest.raises(JournalError, match="another file"):
        JournalReader(path)


def test_damaged_row_is_an_error() -> None:
    with pytest.raises(JournalError, match="damaged"):
        decode_row(msgspec.msgpack.encode({"kind": "intent"}))
    deep = encode_row(row(arguments={"a": "x"})).replace(b"\xa1x", b"\x91" * 100_000)
    with pytest.raises(JournalError, match="damaged"):
        decode_row(deep)


@pytest.mark.parametrize(
    "fields",
    [
        {"wall": 1e300},
        {"wall": -1e11},
        {"wall": float("nan")},
        {"arguments": {"a": msgspec.msgpack.Ext(5, b"x")}},
        {"arguments": {"a": {1: 2}}},
        {"result": {"a": {None: 1}}},
    ],
)
def test_a_row_that_no_journal_of_ours_holds_is_damaged(fields: dict[str, Any]) -> None:
    """Found by `fuzz.journals`: exports and reports of such a row ended with an `OverflowError` or a `TypeError`."""
    foreign = msgspec.to_builtins(row()) | fields
    with pytest.raises(JournalError, match="damaged"):
        decode_row(msgspec.msgpack.encode(foreign))


@pytest.mark.parametrize(("durable", "level"), [(True, 2), (False, 0)])
def test_durable_means_full_synchronisation(path: Path, durable: bool, level: int) -> None:
    writer = JournalWriter(path, durable=durable)
    assert writer._connection.execute("PRAGMA synchronous").fetchone() == (level,)
    assert writer._connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    writer.close()
