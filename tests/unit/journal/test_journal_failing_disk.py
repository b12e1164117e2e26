"""A disk that fails: nothing is acknowledged that it has not, and what it really has is found out before going on."""

from __future__ import annotations

import asyncio
import json
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, schema, verify
from pcmrs.journal.chain import mac_key, row_mac
from pcmrs.journal.group import MOST_WAITING
from pcmrs.journal.keys import signing_key
from pcmrs.journal.rows import chain_hash, encode_row
from pcmrs.journal.soundness import LARGEST_GROUP
from tests import ROOT
from tests.unit.journal.journal_rows import row

needs_strace = pytest.mark.skipif(shutil.which("strace") is None, reason="strace has system calls fail")

PROGRAM = """
import asyncio, json, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from tests.unit.journal.journal_rows import row
from pcmrs.errors import JournalError
from pcmrs.journal import Journal, writer

writer._CHECKPOINT_AFTER = 6

async def main():
    journal = Journal.open(Path(sys.argv[1]))
    acknowledged, failed, reopened, waited, told = [], None, None, 0.0, []
    journal.on_failure(lambda error: told.append(error.text))
    for number in range(16):
        appended = asyncio.ensure_future(journal.append([row(result={"number": number})]))
        while not appended.done():
            await asyncio.sleep(0.001)
            waited = max(waited, journal.oldest_wait)
        try:
            acknowledged.append([number, appended.result()])
        except JournalError as error:
            failed = [number, error.fields["sequence"]]
            break
        await asyncio.sleep(0.005)
        if journal.broken is not None:
            break
    if journal.broken is not None:
        async with asyncio.timeout(10.0):
            while not told:
                await asyncio.sleep(0.001)
        try:
            await journal.append([row()])
            raise SystemExit("appended to a broken journal")
        except JournalError:
            pass
        try:
            reopened = await journal.reopen()
            acknowledged.append([99, await journal.append([row(result={"number": 99})])])
        except JournalError as error:
            reopened = error.text
    await journal.close()
    print(json.dumps({"acknowledged": acknowledged, "failed": failed, "reopened": reopened, "waited": waited}))

asyncio.run(main())
"""


def run(path: Path, suffix: str, inject: str) -> dict[str, Any]:
    """Runs the program with a system call of its writer's thread on one of its files failing or held up."""
    call = inject.partition(":")[0]
    options = ["-f", "-qq", "-o", "/dev/null", "-e", f"trace={call}", "-e", f"inject={inject}", "-P", f"{path}{suffix}"]
    program = [sys.executable, "-c", PROGRAM, str(path), str(ROOT)]
    ended = subprocess.run(["strace", *options, *program], check=True, capture_output=True, text=True, timeout=100)
    found: dict[str, Any] = json.loads(ended.stdout)
    return found


def numbers(path: Path) -> dict[int, int]:
    """The number in each row, to its sequence."""
    with JournalReader(path) as reader:
        rows = [(stored.row.result or {}, stored.sequence) for stored in reader.read()]
    return {result["number"]: sequence for result, sequence in rows if "number" in result}


def stored_text(path: Path) -> str:
    """What the journal says of its reopening."""
    with JournalReader(path) as reader:
        (stored,) = reader.read(source="journal")
    return str((stored.row.result or {})["text"])


@needs_strace
@pytest.mark.parametrize(
    ("suffix", "inject"),
    [
        ("-wal", "pwrite64:error=ENOSPC:when=9"),
        ("-wal", "pwrite64:error=EIO:when=14"),
        ("-wal", "pwrite64:error=EROFS:when=8"),
        ("-wal", "fdatasync:error=EIO:when=4"),
        (".head", "pwrite64:error=EIO:when=5"),
        (".head", "fdatasync:error=EIO:when=3"),
        ("", "fdatasync:error=EIO:when=1"),
    ],
)
def test_after_an_error_of_the_disk_what_it_has_is_found_out(tmp_path: Path, suffix: str, inject: str) -> None:
    path = tmp_path / "journal.sqlite"
    found = run(path, suffix, inject)
    stored = numbers(path)
    assert found["acknowledged"][-1][0] == 99
    assert {number: stored[number] for number, _ in found["acknowledged"]} == dict(found["acknowledged"])
    number, sequence = found["failed"] or (None, None)
    # A checkpoint comes after what it carries over is acknowledged: a row that is appended meanwhile is not written.
    assert (sequence is None) == (suffix == "")
    assert (number in stored) == (sequence is not None and sequence <= found["reopened"])
    assert "cannot be written" in stored_text(path)
    assert verify(path).sound


@needs_strace
def test_nothing_is_acknowledged_while_the_disk_fails(tmp_path: Path) -> None:
    path = tmp_path / "journal.sqlite"
    found = run(path, ".head", "fdatasync:error=EIO:when=3+")
    assert "cannot be written" in found["reopened"]
    assert dict(found["acknowledged"]).keys() == {0, 1}
    assert dict(found["acknowledged"]).items() <= numbers(path).items()


@needs_strace
def test_a_disk_that_stalls_is_waited_for(tmp_path: Path) -> None:
    found = run(tmp_path / "journal.sqlite", "-wal", "fdatasync:delay_enter=700000:when=4")
    assert [sequence for _, sequence in found["acknowledged"]] == list(range(1, 17))
    assert found["waited"] > 0.5


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Another process writes to the journal, and is not ready."""
    with closing(sqlite3.connect(path, isolation_level=None)) as locker:
        locker.execute("BEGIN IMMEDIATE")
        yield
        locker.execute("ROLLBACK")


async def test_a_lock_of_another_process_ends_it_until_it_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(schema, "LOCK_TIMEOUT", 0.05)
    path = tmp_path / "journal.sqlite"
    journal = Journal.open(path)
    await journal.append([row()])
    with locked(path):
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
    with locked(path), pytest.raises(JournalError, match="locked"):
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
