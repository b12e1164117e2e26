"""Source of an archive: a journal is read only up to its head, and only if all of it is proven."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pcmrs.archive._source import JournalSource
from pcmrs.errors import ArchiveError, JournalError
from pcmrs.journal import JournalReader
from pcmrs.journal.rows import START, RowPosition, encode_row
from pcmrs.journal.writer import JournalWriter
from pcmrs.testing.journal import contents
from tests.unit.archive.archives import commands, config, write
from tests.unit.cli.journals import cut
from tests.unit.journal.edited_journal import edit


def test_rows_are_read_as_they_are_in_the_journal(journal_path: Path) -> None:
    with JournalReader(journal_path) as reader, JournalSource(journal_path) as source:
        source.prove(START)
        rows = list(source.read(START, 100))
        assert [(each.sequence, each.row, each.hash) for each in rows] == [
            (stored.sequence, stored.row, stored.hash) for stored in reader.read()
        ]
        after = RowPosition(rows[3].sequence, rows[3].hash)
        source.prove(after)
        assert list(source.read(after, 2)) == rows[4:6]


def test_the_name_is_that_of_the_cell_that_has_written_it(journal_path: Path) -> None:
    with JournalSource(journal_path) as source:
        assert source.name()[:3] == ("lab", "cell1", "ratms")
        assert source.name(("oslo", "c2"))[:3] == ("oslo", "c2", "ratms")
        assert source.name().first == next(source.read(START, 1)).hash.hex()[:16]


def test_a_journal_without_its_cell_needs_a_name(tmp_path: Path) -> None:
    with JournalSource(write(tmp_path / "ratms.sqlite", commands(1))) as source:
        with pytest.raises(ArchiveError, match="add it with --cell SITE/NAME"):
            source.name()
        assert source.name(("lab", "cell1")).site == "lab"


def test_rows_after_the_head_are_left_for_a_later_run(journal_path: Path) -> None:
    head = journal_path.with_name("ratms.sqlite.head")
    before = head.read_bytes()
    write(journal_path, commands(1, start=3))
    head.write_bytes(before)  # as a crash between the two writes leaves it
    with JournalSource(journal_path) as source:
        source.prove(START)
        assert [each.sequence for each in source.read(START, 100)] == list(range(1, 11))


@pytest.mark.parametrize("sequence", [1, 5, 10])
def test_a_changed_row_is_named_before_any_is_read(journal_path: Path, sequence: int) -> None:
    edit(journal_path, "UPDATE journal SET body = zeroblob(9) WHERE sequence = ?", (sequence,))
    with JournalSource(journal_path) as source, pytest.raises(JournalError) as raised:
        source.prove(START)
    assert raised.value.fields["sequence"] == sequence


def test_missing_rows_at_the_end_are_counted(journal_path: Path) -> None:
    cut(journal_path, 7)
    with JournalSource(journal_path) as source, pytest.raises(JournalError, match="3 acknowledged rows are lost"):
        source.prove(START)


def with_head_of(path: Path, other: Path) -> Path:
    """The journal, with the head of another one."""
    path.with_name("ratms.sqlite.head").write_bytes(other.with_name("ratms.sqlite.head").read_bytes())
    return path


def test_a_head_that_was_signed_with_another_key_is_refused(journal_path: Path, tmp_path: Path) -> None:
    other = write(tmp_path / "other" / "ratms.sqlite", [config(), *commands(3)])
    with pytest.raises(JournalError, match="signed with another key"):
        JournalSource(with_head_of(other, journal_path))


def test_a_chain_of_other_rows_is_not_the_signed_one(journal_path: Path, tmp_path: Path) -> None:
    other = tmp_path / "other" / "ratms.sqlite"
    shutil.copytree(journal_path.parent, other.parent, ignore=shutil.ignore_patterns("*sqlite*"))  # its key
    write(other, [config(), *commands(3, start=7)])
    source = JournalSource(with_head_of(other, journal_path))
    with source, pytest.raises(JournalError, match="holds another row 10"):
        source.prove(START)


@pytest.mark.parametrize("name", ["journal.pub", "ratms.sqlite.head", "ratms.sqlite"])
def test_a_journal_without_a_part_is_refused(journal_path: Path, name: str) -> None:
    journal_path.with_name(name).unlink()
    with pytest.raises(JournalError, match="cannot be"):
        JournalSource(journal_path)


def test_a_journal_of_several_files_is_one(tmp_path: Path) -> None:
    path = tmp_path / "ratms.sqlite"
    for start in range(0, 6, 2):
        writer = JournalWriter(path, durable=False, largest=1)
        writer.write([(each, encode_row(each)) for each in (config(), *commands(2, start))])
        writer.close()
    assert len(list(tmp_path.glob("ratms.sqlite.000?"))) == 2
    with JournalSource(path) as source:
        source.prove(START)
        assert [each.sequence for each in source.read(START, 100)] == list(range(1, source.end.sequence + 1))


def test_nothing_of_the_journal_changes(journal_path: Path) -> None:
    before = contents(journal_path.parent)
    with JournalSource(journal_path) as source:
        source.prove(START)
        assert len(list(source.read(START, 100))) == 10
    after = contents(journal_path.parent)
    assert {name: after[name] for name in before} == before
