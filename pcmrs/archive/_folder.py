"""Archive in a folder: a Parquet file for each segment, and the catalogue; questions are answered by DuckDB.

    catalogue.sqlite
    rows/<site>/<cell>/<workflow>-<first>/000000000001.parquet

The files can be read by anything that reads Parquet. They are named by their first row.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import duckdb
import pyarrow as pa
import pyarrow.parquet as pq

from pcmrs.archive._catalogue import Catalogue, ListedSegment
from pcmrs.archive._columns import SCHEMA
from pcmrs.archive._segment import JournalName, Segment, altered, missing
from pcmrs.archive._store import ArchivedJournal
from pcmrs.errors import ArchiveError
from pcmrs.files import make_private, publish, sha256_of

CATALOGUE: Final = "catalogue.sqlite"
ROWS: Final = "rows"
_BATCH: Final = 10_000
"""Rows of an answer that are in memory at once."""


class FolderStore:
    """Archive in a folder, which only its owner can enter: it holds what the journals hold, patients' data included.

    Args:
        folder: The folder.
        make: True to make a new archive if there is none.

    Raises:
        ArchiveError: There is none, or it cannot be used.
    """

    def __init__(self, folder: Path, *, make: bool) -> None:
        self._folder = folder
        try:
            if make:
                _require_own(folder)
                make_private(folder)
        except OSError as error:
            raise ArchiveError(f"{folder} cannot be made: {error.strerror}.", path=str(folder)) from error
        self._catalogue = Catalogue(folder / CATALOGUE, make=make)

    def journals(self) -> list[ArchivedJournal]:
        """See `ArchiveStore.journals`."""
        return self._catalogue.journals()

    def segments(self, journal: JournalName) -> list[Segment]:
        """See `ArchiveStore.segments`."""
        return [listed.segment for listed in self._catalogue.segments(journal)]

    def begin(self, journal: ArchivedJournal) -> None:
        """See `ArchiveStore.begin`."""
        self._catalogue.begin(journal)

    def add(self, segment: Segment, table: pa.Table) -> None:
        """See `ArchiveStore.add`."""
        path = self._path(segment)
        part = path.with_name(f"{path.name}.{os.getpid()}.part")  # another run may write the same segment
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            pq.write_table(table, part, compression="zstd", write_page_checksum=True)
            listed = ListedSegment(segment, part.stat().st_size, sha256_of(part))
            with self._catalogue.entering(listed):
                publish(part, path)
                for left in path.parent.glob(f"{path.name}.*.part"):  # by runs that were killed
                    left.unlink()
        except OSError as error:
            raise ArchiveError(f"{path} cannot be written: {error.strerror or error}.", path=str(path)) from error
        finally:
            part.unlink(missing_ok=True)

    def prove(self, journal: JournalName, head: bytes) -> None:
        """See `ArchiveStore.prove`."""
        self._catalogue.prove(journal, head)

    def read(self, segment: Segment) -> pa.Table:
        """See `ArchiveStore.read`."""
        (listed,) = (each for each in self._catalogue.segments(segment.journal) if each.segment == segment)
        path = self._present(listed)
        try:
            if sha256_of(path) != listed.sha256:
                what = f"{path} has another SHA-256 than the catalogue"
                raise altered(segment.journal, segment.first, segment.last, what)
            return pq.ParquetFile(path).read()
        except (OSError, ValueError, pa.ArrowException) as error:  # ValueError: a name in the file is not UTF-8
            what = f"{path} cannot be read ({error})"
            raise altered(segment.journal, segment.first, segment.last, what) from error

    @contextmanager
    def ask(self, sql: str) -> Iterator[pa.RecordBatchReader]:
        """See `ArchiveStore.ask`."""
        paths = [
            str(self._present(listed))
            for journal in self._catalogue.journals()
            for listed in self._catalogue.segments(journal.name)
        ]
        with duckdb.connect() as connection:
            try:
                _require_one_select(connection, sql)
                self._fence(connection, paths)
                yield connection.sql(sql).to_arrow_reader(_BATCH)
            except (duckdb.Error, pa.ArrowException) as error:  # the latter from reading the answer
                raise ArchiveError(f"The question cannot be answered: {error}") from error

    def unlisted(self) -> list[str]:
        """See `ArchiveStore.unlisted`."""
        listed = {self._path(segment) for journal in self.journals() for segment in self.segments(journal.name)}
        found = (path for path in (self._folder / ROWS).rglob("*") if path.is_file())
        return sorted(str(path.relative_to(self._folder)) for path in found if path not in listed)

    def close(self) -> None:
        """See `ArchiveStore.close`."""
        self._catalogue.close()

    def _path(self, segment: Segment) -> Path:
        return self._folder / ROWS / str(segment.journal) / f"{segment.first:012d}.parquet"

    def _present(self, listed: ListedSegment) -> Path:
        """Return the path of a segment's file, which must have its size."""
        segment, path = listed.segment, self._path(listed.segment)
        if not path.is_file():
            raise missing(segment.journal, segment.first, segment.last, f"there is no {path}")
        if path.stat().st_size != listed.size:
            what = f"{path} has {path.stat().st_size} bytes, and had {listed.size}"
            raise altered(segment.journal, segment.first, segment.last, what)
        return path

    def _fence(self, connection: duckdb.DuckDBPyConnection, paths: list[str]) -> None:
        """Make the table ``rows``, and keep the question from other files, the network, and writing.

        Without a folder for temporary files, an answer that does not fit into memory is refused: it would put patients'
        data into the working directory.
        """
        if paths:
            connection.read_parquet(paths).create_view("rows")
        else:
            connection.from_arrow(SCHEMA.empty_table()).create("rows")
        connection.execute("SET temp_directory = ''")
        connection.execute("SET allowed_directories = [$folder]", {"folder": str(self._folder / ROWS)})
        connection.execute("SET enable_external_access = false")
        connection.execute("SET lock_configuration = true")


def _require_own(folder: Path) -> None:
    """Require that a folder is new, empty or an archive: its mode is changed, and verification reports other files."""
    catalogue = folder / CATALOGUE
    if not folder.exists() or catalogue.exists():
        return
    others = [path.name for path in folder.iterdir() if not path.name.startswith(f"{CATALOGUE}.part")]
    if others:
        text = f"{folder} has other files, such as {min(others)}: give a new or empty folder for the archive."
        raise ArchiveError(text, path=str(folder))


def _require_one_select(connection: duckdb.DuckDBPyConnection, sql: str) -> None:
    statements = connection.extract_statements(sql)
    if [each.type for each in statements] != [duckdb.StatementType.SELECT]:
        kinds = ", ".join(each.type.name for each in statements) or "nothing"
        raise ArchiveError(f"A question is one SELECT, this is {kinds}: give one SELECT about the table rows.")
