"""Contract of the places that hold an archive: a folder and PostgreSQL behave alike."""

from __future__ import annotations

from pathlib import Path

import pytest

from pcmrs.archive import QUESTIONS, ArchiveStore, open_store
from pcmrs.archive._columns import SCHEMA, check_table
from pcmrs.errors import ArchiveError, DoubledSegmentError
from tests.unit.archive.archives import answer, config, entry_of, segment_of, write


def test_a_new_archive_is_empty(store: ArchiveStore) -> None:
    assert (store.journals(), list(store.unlisted())) == ([], [])
    assert answer(store, "SELECT count(*) AS rows FROM rows") == [{"rows": 0}]


def test_a_segment_is_read_as_it_was_added(store: ArchiveStore, journal_path: Path) -> None:
    first, table = segment_of(journal_path, most=4)
    second, rest = segment_of(journal_path, after=first.end)
    store.begin(entry_of(journal_path))
    store.add(first, table)
    store.add(second, rest)
    assert store.segments(first.journal) == [first, second]
    assert store.read(first).equals(table)
    check_table(second, store.read(second))
    assert list(store.unlisted()) == []


def test_journals_are_listed_by_name_with_key_and_head(store: ArchiveStore, tmp_path: Path) -> None:
    names = ("b", "C", "a")
    entries = [entry_of(write(tmp_path / name / "ratms.sqlite", [config("lab", name)])) for name in names]
    for entry in entries:
        store.begin(entry)
    store.prove(entries[0].name, b"head")
    found = store.journals()
    assert [journal.name.cell for journal in found] == ["C", "a", "b"]
    assert found[2].head == b"head"
    assert found[1] == entries[2]


def test_a_segment_that_does_not_follow_is_refused(store: ArchiveStore, journal_path: Path) -> None:
    segment, table = segment_of(journal_path, most=4)
    later, rest = segment_of(journal_path, after=segment.end)
    store.begin(entry_of(journal_path))
    with pytest.raises(DoubledSegmentError, match="another run at the same time"):
        store.begin(entry_of(journal_path))
    with pytest.raises(DoubledSegmentError, match=r"Rows 5–10 .* rows up to 0"):
        store.add(later, rest)
    store.add(segment, table)
    with pytest.raises(DoubledSegmentError, match=r"Rows 1–4 .* rows up to 4, from another run"):
        store.add(segment, table)
    assert store.segments(segment.journal) == [segment]
    assert store.read(segment).equals(table)


def test_a_question_reads_all_rows_and_changes_none(store: ArchiveStore, journal_path: Path) -> None:
    segment, table = segment_of(journal_path)
    store.begin(entry_of(journal_path))
    store.add(segment, table)
    with store.ask("SELECT * FROM rows ORDER BY sequence") as reader:
        found = reader.read_all()
    assert found.schema.names == SCHEMA.names
    assert found.cast(SCHEMA).equals(table)
    for sql in ("DELETE FROM rows", "DROP TABLE rows", "SELECT 1; SELECT 2", "nonsense", "", "SELECT none FROM rows"):
        with pytest.raises(ArchiveError, match=r"one SELECT|cannot be answered"):
            answer(store, sql)
    check_table(segment, store.read(segment))


def test_both_kinds_give_the_same_answers(database: str, folder: Path, journal_path: Path) -> None:
    segment, table = segment_of(journal_path)
    answers = []
    for place in (str(folder), database):
        store = open_store(place, make=True)
        store.begin(entry_of(journal_path))
        store.add(segment, table)
        answers.append([answer(store, question.sql) for question in QUESTIONS.values()])
        store.close()
    assert answers[0] == answers[1]
    assert any(answers[0])
