"""A journal that has grown goes on in a new file: nothing is lost at any step of that, and everything is found."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from pcmrs.errors import JournalError
from pcmrs.files import publish
from pcmrs.journal import Journal, JournalReader, copy_journal, verify
from pcmrs.journal import writer as writer_module
from pcmrs.journal.export import json_lines
from pcmrs.journal.head import HeadFile, head_path
from pcmrs.journal.notes import SOURCE
from pcmrs.journal.reader import journal_files, numbered
from pcmrs.journal.rows import encode_row
from pcmrs.journal.writer import JournalWriter
from tests.unit.journal.journal_rows import outcome, row

EVERY = 3
"""Commits after which the journal is looked after, here."""


SMALL = 1.0
"""Every file has grown beyond this many bytes."""


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(writer_module, "_CHECKPOINT_AFTER", EVERY)
    return tmp_path / "journal.sqlite"


def write(path: Path, many: int) -> None:
    """So many outcomes, one in a commit; the id of each is its number."""
    writer = JournalWriter(path, durable=False, largest=SMALL)
    begun = writer.place.sequence
    for number in range(many):
        item = outcome(f"c{begun + number}")
        writer.write([(item, encode_row(item))])
        writer.maintain()
        assert writer.error is None
    writer.close()


def edit(file: Path, statement: str) -> None:
    with closing(sqlite3.connect(file, isolation_level=None)) as connection:
        for guard in ("no_update", "no_delete"):
            connection.execute(f"DROP TRIGGER {guard}")
        connection.execute(statement)


def test_later_file_continues_the_chain_and_names_the_earlier(path: Path) -> None:
    write(path, 7)
    files = journal_files(path)
    assert [file.name for file in files] == ["journal.sqlite", "journal.sqlite.0002", "journal.sqlite.0003"]

    with JournalReader(path) as reader:
        stored = list(reader.read())
    assert [item.sequence for item in stored] == list(range(1, 10))
    assert all(one.hash == other.previous_hash for one, other in pairwise(stored))
    continued = [item for item in stored if item.row.source == SOURCE]
    assert [item.row.operation for item in continued] == ["continued", "continued"]
    first = continued[0].row.result or {}
    assert (first["earlier"], first["rows"], first["hash"]) == ("journal.sqlite", 3, stored[2].hash.hex())
    found = verify(path)
    assert (found.sound, found.rows, found.signed) == (True, 9, 9)


def test_rows_are_read_across_files_by_every_filter(path: Path) -> None:
    write(path, 9)
    with JournalReader(path) as reader:

        def sequences(**how: Any) -> list[int]:
            return [item.sequence for item in reader.read(**how)]

        everything = sequences()
        assert everything == list(range(1, reader.last_sequence() + 1))
        assert sequences(after=2, before=7) == [3, 4, 5, 6]
        assert sequences(last=5) == everything[-5:]
        assert sequences(last=5, first=2) == everything[-5:-3]
        assert sequences(after=2, first=4) == [3, 4, 5, 6]
        assert [item.sequence for item in reader.read_whole()] == everything
        assert [item.row.command_id for item in reader.read(command_id="c1")] == ["c1"]


def test_the_verdict_of_a_repeat_is_found_in_an_earlier_file(path: Path) -> None:
    write(path, 8)
    with JournalReader(path) as reader:
        verdict = reader.verdict_of("bus:local", "c0")
        assert verdict is not None
        assert verdict.id == "c0"
        assert reader.verdict_of("bus:local", "none") is None


async def test_a_reader_that_is_open_follows(path: Path) -> None:
    journal = Journal.open(path, durable=True, largest=SMALL)
    with JournalReader(path) as other:
        for number in range(8):
            await journal.append([outcome(f"c{number}")])
            assert journal.reader.verdict_of("bus:local", f"c{number}") is not None
        await journal.close()
        assert [item.sequence for item in other.read()] == list(range(1, other.last_sequence() + 1))
    assert len(journal_files(path)) > 2


def test_start_reads_the_newest_file_and_compares_its_first_row(path: Path) -> None:
    write(path, 8)
    middle = journal_files(path)[1]
    edit(middle, "UPDATE journal SET body = x'00' WHERE sequence = 5")  # neither its first row nor its last
    JournalWriter(path, durable=False).close()
    assert verify(path).first_bad == 5

    edit(journal_files(path)[0], "DELETE FROM journal WHERE sequence = 3")
    with pytest.raises(JournalError, match=r"does not follow from the end of journal.sqlite, which is row 2"):
        JournalWriter(path, durable=False)


def test_tail_cut_from_an_earlier_file_is_detected(path: Path) -> None:
    write(path, 8)
    edit(path, "DELETE FROM journal WHERE sequence = 3")
    found = verify(path)
    assert (found.sound, found.rows, found.first_bad) == (False, 2, 3)


@pytest.mark.parametrize("gone", [1, 2])
def test_a_file_that_is_missing_before_the_last_is_named(path: Path, gone: int) -> None:
    write(path, 8)
    name = numbered(path, gone)
    name.rename(name.with_suffix(".away"))
    for attempt in (lambda: JournalWriter(path, durable=False), lambda: JournalReader(path)):
        with pytest.raises(JournalError, match=f"{name.name} of the journal .* is missing"):
            attempt()
    assert any(name.name in problem for problem in verify(path).problems)


def test_missing_last_file_is_a_loss_of_acknowledged_rows(path: Path) -> None:
    write(path, 8)
    journal_files(path)[-1].unlink()
    with pytest.raises(JournalError, match="acknowledged rows are lost"):
        JournalWriter(path, durable=False)
    assert verify(path).missing > 0


def test_file_of_another_journal_is_refused(path: Path) -> None:
    write(path, 2)
    other = path.with_name("other.sqlite")
    write(other, 4)
    numbered(other, 2).rename(numbered(path, 2))
    with pytest.raises(JournalError, match="does not follow"):
        JournalWriter(path, durable=False)


def test_a_copy_has_all_files_and_is_as_good(path: Path, tmp_path: Path) -> None:
    write(path, 8)
    target = tmp_path / "copy" / "session.sqlite"
    target.parent.mkdir()
    copy_journal(path, target)

    assert [file.name for file in journal_files(target)][1] == "session.sqlite.0002"
    assert verify(target).sound
    with JournalReader(path) as reader, JournalReader(target) as copied:
        assert list(json_lines(copied.read())) == list(json_lines(reader.read()))


def test_journal_is_resumed_after_a_power_cut_tears_its_head(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Then the head names a row of the earlier file, and not its last one."""
    writer = JournalWriter(path, durable=False, largest=SMALL)
    for _ in range(EVERY):
        writer.write([(row(), encode_row(row()))])
    monkeypatch.setattr(HeadFile, "write", _fail)
    writer.maintain()
    writer.close()
    counter = 1 + EVERY  # the head was begun with both slots
    with head_path(path).open("r+b") as head:
        head.seek(counter % 2 * 4096)
        head.write(bytes(100))
    monkeypatch.undo()
    again = JournalWriter(path, durable=False)
    assert again.place.sequence == EVERY + 3  # the row that continues, and two notes
    again.close()
    assert verify(path).sound


def _fail(*_: object, **__: object) -> None:
    raise OSError(28, "No space left on device")


def test_unnamed_file_left_by_a_crash_is_no_part_of_the_journal(path: Path) -> None:
    write(path, 2)
    part = numbered(path, 2).with_name("journal.sqlite.0002.part")
    part.write_bytes(b"SQLite format 3\0 and no more")
    write(path, 6)
    assert verify(path).sound
    assert len(journal_files(path)) == 4  # the second run begins one at once
    assert not part.exists()


@pytest.mark.parametrize("step", ["make_database", "publish", "open_for_writing", "head"])
async def test_error_while_a_file_is_started_is_a_failed_write(
    path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    """The journal can be reopened after it."""
    failures: list[JournalError] = []
    journal = Journal.open(path, durable=False, largest=SMALL)
    journal.on_failure(failures.append)
    with monkeypatch.context() as failing:
        module = {"head": "head.HeadFile", "publish": "schema"}.get(step, "writer")
        failing.setattr(f"pcmrs.journal.{module}.{'write' if step == 'head' else step}", _failing(step))
        for number in range(EVERY):
            await journal.append([outcome(f"c{number}")])
    assert [error.code for error in failures] == ["journal_unavailable"]
    with pytest.raises(JournalError, match="No space left"):
        journal.append([row()])

    assert await journal.reopen() == (EVERY if step == "make_database" else EVERY + 1)
    await journal.append([outcome("after")])
    await journal.close()
    assert verify(path).sound
    with JournalReader(path) as reader:
        assert all(reader.verdict_of("bus:local", f"c{number}") for number in range(EVERY))


def _failing(step: str) -> Callable[..., None]:
    """Fails at a step; at that of the head, which every commit writes, only after `EVERY` of them."""
    write, commits = HeadFile.write, iter(range(EVERY))

    def attempt(*arguments: Any, **_: object) -> None:
        if step == "head" and next(commits, None) is not None:
            write(*arguments)
            return
        if step == "publish":
            publish(*arguments)  # the name is there, and nobody knows whether the disk has it
        _fail()

    return attempt
