"""Answers of an archive as files for other software: Parquet or CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from pcmrs.errors import ArchiveError
from pcmrs.files import SECRET, publish

__all__ = ["rows_of", "write_answer"]


def rows_of(answer: pa.RecordBatchReader) -> Iterator[dict[str, Any]]:
    """Yield the rows of an answer as values by the names of their columns.

    Args:
        answer: The answer. No more than a batch of it is in memory.

    Raises:
        ArchiveError: Two columns have one name.
    """
    names = answer.schema.names
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        text = f"The answer has several columns {', '.join(twice)}: give each its own name with AS."
        raise ArchiveError(text, columns=twice)
    for batch in answer:
        yield from batch.to_pylist()


def write_answer(answer: pa.RecordBatchReader, path: Path) -> int:
    """Write an answer to a file, which appears when it is complete; return the number of its rows.

    Args:
        answer: The answer. No more than a batch of it is in memory.
        path: File to write, ``.parquet`` or ``.csv``. Its mode is 0600, because it can hold patients' data. In CSV,
            bytes are hexadecimal and missing values empty.

    Raises:
        ArchiveError: The file has another suffix, or two columns of a CSV file one name.
        OSError: It cannot be written.
    """
    write = {".parquet": _write_parquet, ".csv": _write_csv}.get(path.suffix)
    if write is None:
        raise ArchiveError(f"{path} has no format: name it .parquet or .csv.", path=str(path))
    part = path.with_name(path.name + ".part")
    part.touch(SECRET)
    try:
        rows = write(answer, part)
        publish(part, path)
    finally:
        part.unlink(missing_ok=True)
    return rows


def _write_parquet(answer: pa.RecordBatchReader, path: Path) -> int:
    rows = 0
    with pq.ParquetWriter(path, answer.schema, compression="zstd") as writer:
        for batch in answer:
            writer.write_batch(batch)
            rows += batch.num_rows
    return rows


def _write_csv(answer: pa.RecordBatchReader, path: Path) -> int:
    rows = 0
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(answer.schema.names)
        for row in rows_of(answer):
            writer.writerow([value.hex() if isinstance(value, bytes) else value for value in row.values()])
            rows += 1
    return rows
