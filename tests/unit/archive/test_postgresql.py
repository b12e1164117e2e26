"""Archive in PostgreSQL, on a real server."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import psycopg
import pyarrow as pa
import pytest

from pcmrs.archive import ArchiveStore
from pcmrs.archive._columns import check_table
from pcmrs.archive._postgresql import PostgresStore
from pcmrs.archive._segment import Segment
from pcmrs.errors import AlteredSegmentError, ArchiveError, MissingSegmentError
from tests.unit.archive.archives import answer, entry_of, opened, segment_of


@pytest.fixture
def store(database: str) -> Iterator[ArchiveStore]:
    with opened(database) as made:
        yield made


@pytest.fixture
def segment(store: ArchiveStore, journal_path: Path) -> Segment:
    segment, table = segment_of(journal_path)
    store.begin(entry_of(journal_path))
    store.add(segment, table)
    return segment


def execute(database: str, statement: str) -> None:
    with psycopg.connect(database) as connection:
        connection.execute(statement.encode())


@pytest.mark.parametrize("sequence", [1, 10])
def test_a_missing_row_at_an_end_keeps_answers_back(
    store: ArchiveStore, segment: Segment, database: str, sequence: int
) -> None:
    execute(database, f"DELETE FROM pcmrs_archive.rows WHERE sequence = {sequence}")
    with pytest.raises(MissingSegmentError, match="Rows 1–10 of lab/cell1/ratms"):
        answer(store, "SELECT count(*) FROM rows")


def test_missing_rows_are_found_when_they_are_read(store: ArchiveStore, segment: Segment, database: str) -> None:
    execute(database, "DELETE FROM pcmrs_archive.rows WHERE sequence = 5")
    with pytest.raises(AlteredSegmentError, match="has 9 rows"):
        check_table(segment, store.read(segment))
    execute(database, "DELETE FROM pcmrs_archive.rows")
    with pytest.raises(MissingSegmentError, match="has none of them"):
        store.read(segment)


def test_an_altered_column_is_found(store: ArchiveStore, segment: Segment, database: str) -> None:
    execute(database, "UPDATE pcmrs_archive.rows SET source = 'bus:eve' WHERE sequence = 2")
    with pytest.raises(AlteredSegmentError, match="source in segment 1–10"):
        check_table(segment, store.read(segment))


def test_rows_that_were_put_in_are_found(store: ArchiveStore, segment: Segment, database: str) -> None:
    copied = "INSERT INTO pcmrs_archive.rows (journal, sequence) SELECT journal, 11 FROM pcmrs_archive.rows LIMIT 1"
    execute(database, copied)
    assert list(store.unlisted()) == [f"{segment.journal} row 11"]


def test_a_segment_is_there_as_a_whole_or_not_at_all(
    store: ArchiveStore, journal_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    segment, table = segment_of(journal_path)
    store.begin(entry_of(journal_path))
    column = table.schema.get_field_index("source")
    unfit = table.set_column(column, "source", pa.array(["a\0b"] * table.num_rows))
    with pytest.raises(ArchiveError, match="cannot be used"):
        store.add(segment, unfit)
    assert store.segments(segment.journal) == []
    store.add(segment, table)
    assert store.read(segment).equals(table)


def test_answers_have_types(store: ArchiveStore, segment: Segment) -> None:
    sql = "SELECT count(*) AS n, avg(sequence) AS mean, bool_and(true) AS yes, min(time) AS t, min(kind) AS k FROM rows"
    with store.ask(sql) as reader:
        types = [field.type for field in reader.schema]
    assert types == [pa.int64(), pa.float64(), pa.bool_(), pa.timestamp("us"), pa.string()]


def test_a_server_that_does_not_answer_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(ArchiveError, match="The database cannot be used"):
        PostgresStore(f"postgresql://pcmrs@/none?host={tmp_path}", make=True)
