"""Archive in a PostgreSQL database: tables of rows, segments and journals in the schema `pcmrs_archive`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final

import psycopg
import pyarrow as pa
from psycopg.types.string import TextLoader

from pcmrs.archive._columns import JSON_COLUMNS, SCHEMA
from pcmrs.archive._segment import JournalName, Segment, added_by_another_run, missing
from pcmrs.archive._store import ArchivedJournal
from pcmrs.errors import ArchiveError
from pcmrs.journal.rows import RowPosition

_BATCH: Final = 10_000
"""Rows of an answer that are in memory at once."""
_TYPES: Final = {
    pa.string(): "text",
    pa.int64(): "bigint",
    pa.float64(): "double precision",
    pa.timestamp("us"): "timestamp",
    pa.binary(): "bytea",
}
_COLUMNS: Final = ", ".join(
    # `json` keeps the text as it is, which is compared when the archive is verified; `jsonb` would not.
    f"{field.name} {'json' if field.name in JSON_COLUMNS else _TYPES[field.type]}"
    for field in SCHEMA
)
_TABLES: Final = (
    "CREATE SCHEMA pcmrs_archive",
    "CREATE TABLE pcmrs_archive.journals (site text NOT NULL, cell text NOT NULL, workflow text NOT NULL, "
    "first text PRIMARY KEY, key bytea NOT NULL, head bytea NOT NULL)",
    "CREATE TABLE pcmrs_archive.segments (journal text NOT NULL REFERENCES pcmrs_archive.journals, "
    "start bigint NOT NULL, start_hash bytea NOT NULL, last bigint NOT NULL, last_hash bytea NOT NULL, "
    "PRIMARY KEY (journal, start))",
    f"CREATE TABLE pcmrs_archive.rows ({_COLUMNS}, PRIMARY KEY (journal, sequence))",
    "CREATE INDEX ON pcmrs_archive.rows (kind, branch, operation)",
)
_JOURNAL: Final = "site || '/' || cell || '/' || workflow || '-' || first"
"""Name of a journal of the table journals, as in the table rows."""
_NAMES: Final = ", ".join(SCHEMA.names)
_ARROW: Final = {
    "bool": pa.bool_(),
    **dict.fromkeys(("int2", "int4", "int8"), pa.int64()),
    **dict.fromkeys(("float4", "float8", "numeric"), pa.float64()),
    "timestamp": pa.timestamp("us"),
    "bytea": pa.binary(),
}
"""Types of an answer by the names that PostgreSQL gives them; all others become text."""


class PostgresStore:
    """Archive in a PostgreSQL database.

    A segment, its rows and its entry in the catalogue are one transaction.

    Args:
        address: Address of the database (``postgresql://user@host/name``).
        make: True to make the tables if there are none.

    Raises:
        ArchiveError: The database cannot be reached, or has no archive.
    """

    def __init__(self, address: str, *, make: bool) -> None:
        with _readable_errors():
            self._connection = psycopg.connect(address, autocommit=True)
        self._connection.adapters.register_loader("json", TextLoader)  # not as the object that the text describes
        try:
            with _readable_errors():
                self._open(make=make)
        except ArchiveError:
            self.close()
            raise

    def journals(self) -> list[ArchivedJournal]:
        """See `ArchiveStore.journals`."""
        query = "SELECT site, cell, workflow, first, key, head FROM journals"
        with _readable_errors():
            found = [ArchivedJournal(JournalName(*row[:4]), *row[4:]) for row in self._connection.execute(query)]
        return sorted(found, key=lambda journal: journal.name)  # by code points, whatever the database's collation is

    def segments(self, journal: JournalName) -> list[Segment]:
        """See `ArchiveStore.segments`."""
        query = "SELECT start, start_hash, last, last_hash FROM segments WHERE journal = %s ORDER BY start"
        with _readable_errors():
            return [
                Segment(journal, RowPosition(*row[:2]), RowPosition(*row[2:]))
                for row in self._connection.execute(query, (journal.first,))
            ]

    def begin(self, journal: ArchivedJournal) -> None:
        """See `ArchiveStore.begin`."""
        values = (*journal.name, journal.key, journal.head)
        with _readable_errors():
            try:
                self._connection.execute("INSERT INTO journals VALUES (%s, %s, %s, %s, %s, %s)", values)
            except psycopg.errors.UniqueViolation as error:
                raise added_by_another_run(journal.name) from error

    def add(self, segment: Segment, table: pa.Table) -> None:
        """See `ArchiveStore.add`."""
        columns = [column.to_pylist() for column in table.columns]
        with _readable_errors(), self._connection.transaction():
            self._require_next(segment)
            with self._connection.cursor().copy(f"COPY rows ({_NAMES}) FROM STDIN".encode()) as copy:
                for row in zip(*columns, strict=True):
                    copy.write_row(row)
            self._connection.execute(
                "INSERT INTO segments VALUES (%s, %s, %s, %s, %s)",
                (
                    segment.journal.first,
                    *(segment.start.sequence, segment.start.hash, segment.end.sequence, segment.end.hash),
                ),
            )

    def prove(self, journal: JournalName, head: bytes) -> None:
        """See `ArchiveStore.prove`."""
        with _readable_errors():
            self._connection.execute("UPDATE journals SET head = %s WHERE first = %s", (head, journal.first))

    def read(self, segment: Segment) -> pa.Table:
        """See `ArchiveStore.read`."""
        query = f"SELECT {_NAMES} FROM rows WHERE journal = %s AND sequence BETWEEN %s AND %s ORDER BY sequence"  # noqa: S608  # constants
        with _readable_errors():
            rows = self._connection.execute(
                query.encode(), (str(segment.journal), segment.first, segment.last)
            ).fetchall()
        if not rows:
            raise missing(segment.journal, segment.first, segment.last, "the table rows has none of them")
        return _table(rows, SCHEMA)

    @contextmanager
    def ask(self, sql: str) -> Iterator[pa.RecordBatchReader]:
        """See `ArchiveStore.ask`."""
        self._require_segments()
        try:
            with self._connection.transaction():
                self._connection.execute("SET TRANSACTION READ ONLY")
                with self._connection.cursor("answer") as cursor:
                    cursor.execute(sql.encode())
                    schema = self._schema_of(cursor)
                    yield pa.RecordBatchReader.from_batches(schema, _batches(cursor, schema))
        except psycopg.Error as error:
            raise ArchiveError(f"The question cannot be answered: {error}. Give one SELECT.") from error

    def unlisted(self) -> Sequence[str]:
        """See `ArchiveStore.unlisted`; rows and catalogue are written together, so only another program leaves any."""
        query = (
            "SELECT journal || ' row ' || sequence FROM rows WHERE NOT EXISTS (SELECT FROM segments JOIN journals "  # noqa: S608  # constants
            f"ON first = segments.journal WHERE rows.journal = {_JOURNAL} AND sequence > start AND sequence <= last) "
            "ORDER BY 1 LIMIT 10"
        )
        with _readable_errors():
            return [name for (name,) in self._connection.execute(query.encode())]

    def close(self) -> None:
        """See `ArchiveStore.close`."""
        self._connection.close()

    def _open(self, *, make: bool) -> None:
        with self._connection.transaction():
            self._connection.execute("SELECT pg_advisory_xact_lock(hashtext('pcmrs_archive'))")  # two may make it
            query = "SELECT FROM pg_namespace WHERE nspname = 'pcmrs_archive'"
            if self._connection.execute(query).fetchone() is None:
                if not make:
                    text = "The database has no archive: `pcmrs archive add` makes one."
                    raise ArchiveError(text)
                for statement in _TABLES:
                    self._connection.execute(statement.encode())
        self._connection.execute("SET search_path = pcmrs_archive")

    def _require_next(self, segment: Segment) -> None:
        """Require that a segment follows the last one, and lock its journal against other runs until the commit."""
        self._connection.execute("SELECT FROM journals WHERE first = %s FOR UPDATE", (segment.journal.first,))
        query = "SELECT coalesce(max(last), 0) FROM segments WHERE journal = %s"
        found = self._connection.execute(query, (segment.journal.first,)).fetchone()
        if found is not None and found[0] != segment.start.sequence:
            raise added_by_another_run(segment.journal, found[0], segment)

    def _require_segments(self) -> None:
        """Require that the first and the last row of each segment are there; only a verification reads all of them."""
        exists = f"EXISTS (SELECT FROM rows WHERE rows.journal = {_JOURNAL} AND sequence = {{}})"
        query = (
            "SELECT site, cell, workflow, first, start, start_hash, last, last_hash FROM segments JOIN journals "  # noqa: S608  # constants
            f"ON first = segments.journal WHERE NOT ({exists.format('start + 1')} AND {exists.format('last')}) LIMIT 1"
        )
        with _readable_errors():
            found = self._connection.execute(query.encode()).fetchone()
        if found is not None:
            segment = Segment(JournalName(*found[:4]), RowPosition(*found[4:6]), RowPosition(*found[6:]))
            raise missing(segment.journal, segment.first, segment.last, f"{segment} is not whole in the table rows")

    def _schema_of(self, cursor: psycopg.ServerCursor[Any]) -> pa.Schema:
        types = self._connection.adapters.types
        names = [(each.name, types.get(each.type_code)) for each in cursor.description or ()]
        return pa.schema([(name, _ARROW.get(found.name if found else "", pa.string())) for name, found in names])


def _batches(cursor: psycopg.ServerCursor[Any], schema: pa.Schema) -> Iterator[pa.RecordBatch]:
    while rows := cursor.fetchmany(_BATCH):
        yield from _table(rows, schema).to_batches()


def _table(rows: Sequence[tuple[Any, ...]], schema: pa.Schema) -> pa.Table:
    columns = zip(*rows, strict=True)
    return pa.table([_array(values, field.type) for values, field in zip(columns, schema, strict=True)], schema=schema)


def _array(values: Sequence[Any], kind: pa.DataType) -> pa.Array:
    if kind == pa.float64():
        return pa.array([None if value is None else float(value) for value in values], kind)  # numeric is a Decimal
    if kind == pa.string():
        return pa.array([value if value is None or isinstance(value, str) else str(value) for value in values], kind)
    return pa.array(values, kind)


@contextmanager
def _readable_errors() -> Iterator[None]:
    try:
        yield
    except psycopg.Error as error:
        raise ArchiveError(f"The database cannot be used: {error}. Check its address, rights and space.") from error
