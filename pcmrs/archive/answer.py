"""Answers of an archive as files for other software: Parquet or CSV."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pq

from pcmrs.errors import ArchiveError
from pcmrs.files import SECRET, publish


def write_answer(answer: pa.RecordBatchReader, path: Path) -> int:
    """Write an answer to a file, which appears when it is complete; return the number of its rows.

    Args:
        answer: The answer. No more than a batch of it is in memory.
        path: File to write, ``.parquet`` or ``.csv``. Its mode is 0600, because it can hold patients' data.

    Raises:
        ArchiveError: The file has another suffix.
        OSError: It cannot be written.
    """
    if path.suffix not in (".parquet", ".csv"):
        raise ArchiveError(f"{path} has no format: name it .parquet or .csv.", path=str(path))
    part, rows = path.with_name(path.name + ".part"), 0
    part.touch(SECRET)
    try:
        with _writer(part, path.suffix, answer.schema) as writer:
            for batch in answer:
                writer.write_batch(batch)
                rows += batch.num_rows
        publish(part, path)
    finally:
        part.unlink(missing_ok=True)
    return rows


def _writer(path: Path, suffix: str, schema: pa.Schema) -> pq.ParquetWriter | pa_csv.CSVWriter:
    return (
        pq.ParquetWriter(path, schema, compression="zstd") if suffix == ".parquet" else pa_csv.CSVWriter(path, schema)
    )
