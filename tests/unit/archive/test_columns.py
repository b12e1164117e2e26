"""Columns of archived rows: each is derived from the row's body, and a change of any is found."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pytest

from pcmrs.archive._columns import SCHEMA, check_table, table_of
from pcmrs.archive._source import JournalSource
from pcmrs.errors import AlteredSegmentError
from pcmrs.journal import JournalReader
from pcmrs.journal.rows import START, RowPosition, decode_row
from tests.unit.archive.archives import commands, config, failed, segment_of, write


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write(tmp_path / "cell" / "ratms.sqlite", [config(), *commands(2), failed("c9", "stopped")])


def test_columns_hold_what_the_rows_hold(path: Path) -> None:
    _, table = segment_of(path)
    with JournalReader(path) as reader:
        stored = list(reader.read())
    found = table.to_pylist()
    assert [each["sequence"] for each in found] == [each.sequence for each in stored]
    assert [decode_row(each["body"]) for each in found] == [each.row for each in stored]
    assert [each["hash"] for each in found] == [each.hash for each in stored]
    assert json.loads(found[1]["arguments"]) == stored[1].row.arguments
    assert json.loads(found[2]["verdict_result"]) == {"residual": 0.0023}
    assert json.loads(found[3]["result"]) == {"é": 0}
    assert (found[7]["decision"], found[7]["reason"], found[7]["reason_text"]) == ("failed", "stopped", "Stopped.")
    assert {(each["site"], each["cell"], each["workflow"]) for each in found} == {("lab", "cell1", "ratms")}
    assert found[0]["time"].isoformat() == "2023-11-14T22:13:20"


def test_a_table_is_the_same_in_parts_of_any_size(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    segment, table = segment_of(path)
    monkeypatch.setattr("pcmrs.archive._columns._AT_ONCE", 3)
    with JournalSource(path) as source:
        assert table_of(segment.journal, source.read(START, 100)).equals(table)


def test_a_whole_table_is_accepted(path: Path) -> None:
    check_table(*segment_of(path))


def changed(column: pa.ChunkedArray, kind: pa.DataType) -> pa.Array:
    """The column with another value in its third row."""
    values = column.to_pylist()
    if pa.types.is_timestamp(kind):
        values[2] = values[2].replace(year=1999)
    elif pa.types.is_binary(kind):
        values[2] = bytes(32)
    else:
        values[2] = "x" if pa.types.is_string(kind) else 7
    return pa.array(values, kind)


@pytest.mark.parametrize("name", SCHEMA.names)
def test_a_change_of_any_column_is_found(path: Path, name: str) -> None:
    segment, table = segment_of(path)
    index = table.schema.get_field_index(name)
    forged = table.set_column(index, SCHEMA.field(name), changed(table.column(name), SCHEMA.field(name).type))
    with pytest.raises(AlteredSegmentError) as raised:
        check_table(segment, forged)
    assert raised.value.fields["cell"] == "lab/cell1"
    if name in ("body", "hash"):
        assert (raised.value.fields["first"], raised.value.fields["last"]) == (3, 3)
    else:
        assert name in raised.value.text


def test_missing_and_moved_rows_are_found(path: Path) -> None:
    segment, table = segment_of(path)
    with pytest.raises(AlteredSegmentError, match="has 7 rows"):
        check_table(segment, table.slice(1))
    with pytest.raises(AlteredSegmentError):
        check_table(segment, table.take(pc.sort_indices(table, [("sequence", "descending")])))
    with pytest.raises(AlteredSegmentError):
        check_table(segment, table.drop_columns(["wall"]))


def test_rows_of_another_chain_are_found(path: Path, tmp_path: Path) -> None:
    segment, _ = segment_of(path)
    _, other = segment_of(write(tmp_path / "other" / "ratms.sqlite", [config("oslo"), *commands(2), config()]))
    with pytest.raises(AlteredSegmentError, match="ends with another hash"):
        check_table(segment, other)


@pytest.mark.parametrize(("start", "rows"), [(0, 0), (-3, 7)])
def test_a_segment_of_no_rows_or_a_negative_one_is_altered(path: Path, start: int, rows: int) -> None:
    """Found while writing `fuzz.archives`: it ended with an error of Arrow, or of an integer that has no bytes."""
    segment, table = segment_of(path)
    claimed = replace(
        segment, start=RowPosition(start, segment.start.hash), end=RowPosition(start + rows, segment.end.hash)
    )
    with pytest.raises(AlteredSegmentError):
        check_table(claimed, table.slice(0, rows))
