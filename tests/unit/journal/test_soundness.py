"""What is lost, set back, forged or taken away is found before the journal is written, with what to do."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, JournalRow, Kind, verify
from pcmrs.journal.head import head_path
from pcmrs.journal.rows import chain_hash, encode_row
from pcmrs.journal.schema import WITHOUT_MAC
from pcmrs.journal.writer import JournalWriter
from pcmrs.testing.journal import HEAD, NAME, append_past_head, append_without_key, place
from tests.unit.journal.edited_journal import alter, check_refused, edit, operations
from tests.unit.journal.journal_rows import outcome, row
from tests.unit.journal.whole_journal import Sample


def replace_from(path: Path, sequence: int, body: bytes) -> None:
    """Another row, and all that follow chained to it: right in themselves."""
    with JournalReader(path) as reader:
        rows = list(reader.read(after=sequence - 1))
    previous = rows[0].previous_hash
    for stored in rows:
        new = body if stored.sequence == sequence else encode_row(stored.row)
        own = chain_hash(previous, stored.sequence, new)
        statement = "UPDATE journal SET body = ?, previous_hash = ?, hash = ? WHERE sequence = ?"
        edit(path, statement, (new, previous, own, stored.sequence))
        previous = own


async def test_journal_set_back_is_detected(killed_path: Path, killed_journal: Sample) -> None:
    journal = Journal.open(killed_path)
    await journal.append([row()] * 3)
    await journal.close()
    kept = killed_path.with_name(HEAD).read_bytes()
    later = place({**killed_journal.files, HEAD: kept}, killed_path.parent.with_name("set back"))
    with pytest.raises(JournalError, match="3 acknowledged rows are lost"):
        Journal.open(later)


def test_more_rows_than_a_crash_leaves_are_an_error(killed_path: Path) -> None:
    append_without_key(killed_path, [row()] * 600)
    with pytest.raises(JournalError, match="600 rows after the last one"):
        Journal.open(killed_path)
    assert not verify(killed_path).sound


def test_journal_that_lost_head_and_keys_is_not_sound(tmp_path: Path) -> None:
    """It is not taken for one that never had them."""
    path = tmp_path / NAME
    JournalWriter(path, durable=False).close()
    for name in (HEAD, "journal.key", "journal.pub"):
        path.with_name(name).unlink()
    found = verify(path)
    assert (found.signature, found.signed, found.sound) == ("does not hold", 0, False)


def test_a_damaged_journal_of_version_1_is_left_as_it_is(version_1: Path) -> None:
    alter(version_1, "DROP TRIGGER no_update", "UPDATE journal SET wall = 0 WHERE sequence = 2")
    before = version_1.read_bytes()
    with pytest.raises(JournalError):
        Journal.open(version_1)
    assert version_1.read_bytes() == before
    assert not version_1.with_name(HEAD).exists()


def test_only_the_end_is_read_when_a_snapshot_is_near(killed_path: Path) -> None:
    """What lies before it is found by `verify`."""
    writer = JournalWriter(killed_path, durable=False)
    for kind in ("event", "snapshot", "event"):
        writer.write([(row(kind), encode_row(row(kind)))])
    writer.close()
    with JournalReader(killed_path) as reader:
        (guard,) = reader._files[-1][1].execute("SELECT sql FROM sqlite_schema WHERE name = 'no_update'").fetchone()
    alter(killed_path, "DROP TRIGGER no_update", "UPDATE journal SET body = x'00' WHERE sequence = 3", guard)
    JournalWriter(killed_path, durable=False).close()
    assert verify(killed_path).first_bad == 3
    alter(killed_path, "DROP TRIGGER no_update", "UPDATE journal SET body = x'00' WHERE sequence = 20", guard)
    with pytest.raises(JournalError, match="row 20"):
        JournalWriter(killed_path, durable=False)


"""Made by a program of version 2: nine rows, all of them named by the head."""


@pytest.mark.parametrize("number", [1, 512])
def test_rows_added_without_the_key_are_refused_from_the_first(whole_path: Path, number: int) -> None:
    append_without_key(whole_path, [row()] * number)
    found = verify(whole_path)
    assert (found.rows, found.first_bad, found.unnamed) == (18 + number, None, number), "they are well chained"
    check_refused(whole_path, 19, "It was written without the key")


async def test_unnamed_rows_with_macs_are_adopted_after_a_crash(whole_path: Path) -> None:
    rows: list[JournalRow] = [row(), outcome("late")]
    append_past_head(whole_path, rows)
    assert verify(whole_path).unnamed == 2
    await Journal.open(whole_path).close()
    assert operations(whole_path) == ["head_behind"]
    with JournalReader(whole_path) as reader:
        assert [stored.row for stored in reader.read(after=18, first=2)] == rows
    assert verify(whole_path).unnamed == 0


@pytest.mark.parametrize("forged", [None, bytes(32), b""])
def test_row_forged_after_those_of_a_crash_is_refused_by_number(whole_path: Path, forged: object) -> None:
    append_past_head(whole_path, [row()])
    append_without_key(whole_path, [row()], mac=forged)
    check_refused(whole_path, 20, "It was written without the key")


def test_a_journal_that_calls_itself_older_gets_no_rows_either(whole_path: Path) -> None:
    with closing(sqlite3.connect(whole_path)) as connection, connection:
        connection.execute("ALTER TABLE journal DROP COLUMN mac")
        connection.execute(f"PRAGMA user_version = {WITHOUT_MAC}")
    append_without_key(whole_path, [row()])
    check_refused(whole_path, 19, "Rows of version 2 have none")


def test_unnamed_rows_of_a_version_2_journal_get_no_mac(version_2: Path) -> None:
    append_without_key(version_2, [row()])
    assert verify(version_2).unnamed == 1
    check_refused(version_2, 10, "start the version of PCMRS before")


async def test_crash_in_the_upgrade_leaves_a_usable_journal(version_2: Path) -> None:
    before = head_path(version_2).read_bytes()
    await Journal.open(version_2).close()
    head_path(version_2).write_bytes(before)
    await Journal.open(version_2).close()
    assert operations(version_2) == ["mac_begun", "head_behind"]


async def test_grown_journal_of_version_2_is_read_with_its_later_file(version_2: Path) -> None:
    journal = Journal.open(version_2, largest=0)
    await journal.append([row()])
    await journal.close()
    assert verify(version_2).sound
    append_without_key(version_2.with_name(f"{NAME}.0002"), [row()])
    with pytest.raises(JournalError, match="It was written without the key"):
        Journal.open(version_2)


def test_replaced_last_row_is_not_the_one_named_by_the_head(whole_path: Path) -> None:
    replace_from(whole_path, 15, encode_row(row(result={"number": -1})))
    with pytest.raises(JournalError, match="another row 18 than the one that its signed head names"):
        Journal.open(whole_path)
    found = verify(whole_path)
    assert (found.sound, found.rows, found.signed) == (False, 18, 0)


def test_snapshot_after_the_row_named_by_the_head_hides_nothing(
    whole_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = JournalWriter(whole_path, durable=False)
    monkeypatch.setattr(writer._head, "write", lambda place: None)
    for kind in ("event", "snapshot", "event"):
        writer.write([(row(kind), encode_row(row(kind)))])
    writer.close()
    replace_from(whole_path, 18, encode_row(row(result={"number": -1})))
    with pytest.raises(JournalError, match="another row 18"):
        Journal.open(whole_path)


@pytest.mark.parametrize("kind", ["snapshot", "config"])
def test_a_journal_that_calls_itself_older_still_needs_its_head(whole_path: Path, kind: Kind) -> None:
    writer = JournalWriter(whole_path, durable=False)
    writer.write([(row(kind), encode_row(row(kind)))])
    writer.close()
    edit(whole_path, "ALTER TABLE journal DROP COLUMN mac")
    edit(whole_path, "PRAGMA user_version = 1")
    whole_path.with_name(HEAD).unlink()
    with pytest.raises(JournalError, match="holds rows of a later one"):
        Journal.open(whole_path)
    assert not whole_path.with_name(HEAD).exists()
