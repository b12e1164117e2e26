"""Rows after the head are taken up only when they have their MAC: Somebody without the key cannot have them signed."""

from __future__ import annotations

import sqlite3
import tarfile
from contextlib import closing
from pathlib import Path

import pytest

from pcmrs.errors import JournalError
from pcmrs.journal import Journal, JournalReader, JournalRow, copy_journal, verify
from pcmrs.journal.chain import mac_key, row_mac
from pcmrs.journal.head import head_path
from pcmrs.journal.keys import signing_key
from pcmrs.journal.schema import HEADLESS, VERSION, WITHOUT_MAC, statements
from pcmrs.testing.journal import NAME, contents, place
from pcmrs_lab.campaign.damage import append_past_head, append_without_key
from tests.unit.journal.journal_rows import outcome, row
from tests.unit.journal.whole_journal import sample

OLD = Path(__file__).with_name("version_2.tar.gz")
"""Made by a program of version 2: nine rows, all of them named by the head."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "whole").mkdir()
    return place(sample(tmp_path / "whole", killed=False).files, tmp_path / "cell")


@pytest.fixture
def old(tmp_path: Path) -> Path:
    with tarfile.open(OLD) as archive:
        archive.extractall(tmp_path / "old", filter="data")
    (tmp_path / "old" / "journal.key").chmod(0o600)
    return tmp_path / "old" / NAME


def macs(path: Path) -> list[bytes | None]:
    with closing(sqlite3.connect(path)) as connection:
        return [mac for (mac,) in connection.execute("SELECT mac FROM journal ORDER BY sequence")]


def operations(path: Path) -> list[str | None]:
    with JournalReader(path) as reader:
        return [stored.row.operation for stored in reader.read(source="journal")]


def check_refused(path: Path, sequence: int, words: str) -> None:
    before = contents(path.parent)
    with pytest.raises(
        JournalError, match=rf"row {sequence} follows the last one.*{words}.*another cell.folder"
    ) as told:
        Journal.open(path)
    assert told.value.fields["sequence"] == sequence
    assert contents(path.parent).items() >= before.items(), "the journal was changed"


@pytest.mark.parametrize("number", [1, 512])
def test_rows_added_without_the_key_are_refused_from_the_first(path: Path, number: int) -> None:
    append_without_key(path, [row()] * number)
    found = verify(path)
    assert (found.rows, found.first_bad, found.unnamed) == (18 + number, None, number), "they are well chained"
    check_refused(path, 19, "It was written without the key")


async def test_unnamed_rows_with_macs_are_adopted_after_a_crash(path: Path) -> None:
    rows: list[JournalRow] = [row(), outcome("late")]
    append_past_head(path, rows)
    assert verify(path).unnamed == 2
    await Journal.open(path).close()
    assert operations(path) == ["head_behind"]
    with JournalReader(path) as reader:
        assert [stored.row for stored in reader.read(after=18, first=2)] == rows
    assert verify(path).unnamed == 0


@pytest.mark.parametrize("forged", [None, bytes(32), b""])
def test_row_forged_after_those_of_a_crash_is_refused_by_number(path: Path, forged: object) -> None:
    append_past_head(path, [row()])
    append_without_key(path, [row()], mac=forged)
    check_refused(path, 20, "It was written without the key")


def test_a_mac_of_another_row_or_of_another_key_is_none(path: Path, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    own, other = (mac_key(signing_key(folder, make=True)) for folder in (path.parent, tmp_path / "other"))
    append_without_key(path, [row()], mac=macs(path)[-1])
    check_refused(path, 19, "It was written without the key")
    with JournalReader(path) as reader:
        (added,) = reader.read(last=1)
    assert len({row_mac(own, added.hash), row_mac(other, added.hash), macs(path)[-1]}) == 3


def test_a_journal_that_calls_itself_older_gets_no_rows_either(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("ALTER TABLE journal DROP COLUMN mac")
        connection.execute(f"PRAGMA user_version = {WITHOUT_MAC}")
    append_without_key(path, [row()])
    check_refused(path, 19, "Rows of version 2 have none")


async def test_journal_of_version_2_continues_with_macs_for_new_rows(old: Path) -> None:
    assert (verify(old).version, verify(old).sound) == (WITHOUT_MAC, True)
    for _ in range(2):
        journal = Journal.open(old)
        assert journal.reader.verdict_of("bus:local", "c2") is not None
        await journal.close()
    assert operations(old) == ["mac_begun"]
    found = verify(old)
    assert (found.sound, found.version, found.rows, found.signed) == (True, VERSION, 10, 10)
    assert [mac is not None for mac in macs(old)] == [False] * 9 + [True]


def test_unnamed_rows_of_a_version_2_journal_get_no_mac(old: Path) -> None:
    append_without_key(old, [row()])
    assert verify(old).unnamed == 1
    check_refused(old, 10, "start the version of PCMRS before")


async def test_crash_in_the_upgrade_leaves_a_usable_journal(old: Path) -> None:
    before = head_path(old).read_bytes()
    await Journal.open(old).close()
    head_path(old).write_bytes(before)
    await Journal.open(old).close()
    assert operations(old) == ["mac_begun", "head_behind"]


async def test_grown_journal_of_version_2_is_read_with_its_later_file(old: Path) -> None:
    journal = Journal.open(old, largest=0)
    await journal.append([row()])
    await journal.close()
    assert verify(old).sound
    append_without_key(old.with_name(f"{NAME}.0002"), [row()])
    with pytest.raises(JournalError, match="It was written without the key"):
        Journal.open(old)


def test_a_copy_keeps_what_tells_rows_of_a_crash_from_others(path: Path, tmp_path: Path) -> None:
    append_past_head(path, [row()])
    (tmp_path / "copy").mkdir()
    copy_journal(path, tmp_path / "copy" / NAME)
    assert macs(tmp_path / "copy" / NAME) == macs(path)


def test_an_upgraded_file_is_made_as_a_new_one() -> None:
    """Otherwise its schema would be refused."""
    assert statements(HEADLESS) == statements(WITHOUT_MAC)
    with closing(sqlite3.connect(":memory:")) as connection:
        connection.execute(statements(WITHOUT_MAC)["journal"])
        connection.execute("ALTER TABLE journal ADD COLUMN mac BLOB")
        (made,) = connection.execute("SELECT sql FROM sqlite_schema WHERE name = 'journal'").fetchone()
    assert made == statements(VERSION)["journal"]
