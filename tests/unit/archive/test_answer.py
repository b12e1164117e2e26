"""Answers as files: Parquet for analysis, CSV for tables."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import polars
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from pcmrs.archive.answer import rows_of, write_answer
from pcmrs.errors import ArchiveError

TABLE = pa.table({"name": ["a", None, 'with "quotes"'], "mm": [1.5, None, 2.0], "hash": [b"\x01\xff", None, b""]})


def reader() -> pa.RecordBatchReader:
    return TABLE.to_reader(max_chunksize=2)


def test_parquet_holds_the_answer(tmp_path: Path) -> None:
    path = tmp_path / "answer.parquet"
    assert write_answer(reader(), path) == 3
    assert pq.read_table(path).equals(TABLE)
    assert path.stat().st_mode & 0o777 == 0o600


def test_csv_has_hexadecimal_bytes_and_empty_values(tmp_path: Path) -> None:
    path = tmp_path / "answer.csv"
    assert write_answer(reader(), path) == 3
    with path.open(newline="") as file:
        assert list(csv.reader(file)) == [
            ["name", "mm", "hash"],
            ["a", "1.5", "01ff"],
            ["", "", ""],
            ['with "quotes"', "2.0", ""],
        ]


def test_polars_reads_the_answer(tmp_path: Path) -> None:
    path = tmp_path / "answer.parquet"
    write_answer(reader(), path)
    assert polars.read_parquet(path)["mm"].to_list() == [1.5, None, 2.0]


def test_another_format_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(ArchiveError, match=r"\.parquet or \.csv"):
        write_answer(reader(), tmp_path / "answer.xlsx")
    assert list(tmp_path.iterdir()) == []


def test_an_answer_that_fails_leaves_no_file(tmp_path: Path) -> None:
    def batches() -> Iterator[pa.RecordBatch]:
        yield TABLE.to_batches()[0]
        raise ArchiveError("The server has gone.")

    for suffix in ("parquet", "csv"):
        failing = pa.RecordBatchReader.from_batches(TABLE.schema, batches())
        with pytest.raises(ArchiveError, match="gone"):
            write_answer(failing, tmp_path / f"answer.{suffix}")
    assert list(tmp_path.iterdir()) == []


def test_two_columns_of_one_name_are_refused(tmp_path: Path) -> None:
    twice = pa.table([[1], [2]], names=["n", "n"])
    with pytest.raises(ArchiveError, match="several columns n"):
        list(rows_of(twice.to_reader()))
    with pytest.raises(ArchiveError, match="several columns n"):
        write_answer(twice.to_reader(), tmp_path / "answer.csv")
