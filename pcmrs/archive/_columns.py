"""Columns of archived rows as Apache Arrow tables, and the check that a table is what was archived."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import Any, Final

import msgspec
import pyarrow as pa
import pyarrow.compute as pc

from pcmrs.archive._segment import JournalName, Segment, altered
from pcmrs.archive._source import ProvenRow
from pcmrs.errors import JournalError
from pcmrs.journal.rows import RowPosition, chain_hash, decode_row

_NAME: Final = ("site", "cell", "workflow", "journal")
_JSON: Final = ("arguments", "states", "result", "verdict_result")
_FIELDS: Final[dict[str, pa.DataType]] = {
    **dict.fromkeys(_NAME, pa.string()),
    "sequence": pa.int64(),
    "time": pa.timestamp("us"),
    "wall": pa.float64(),
    "monotonic": pa.float64(),
    **dict.fromkeys(("kind", "source", "command_id", "user_name", "role", "branch", "operation"), pa.string()),
    **dict.fromkeys(("decision", "reason", "reason_text", "state"), pa.string()),
    **dict.fromkeys(_JSON, pa.string()),
    **dict.fromkeys(("parent", "session_id", "boot_id"), pa.string()),
    **dict.fromkeys(("blueprint", "blueprint_version", "blueprint_hash"), pa.string()),
    "body": pa.binary(),
    "hash": pa.binary(),
}
SCHEMA: Final = pa.schema(list(_FIELDS.items()))
"""Columns of an archived row.

``time`` is UTC, and ``wall`` the same in Unix seconds; ``monotonic`` is in seconds of the cell's clock. ``arguments``,
``states``, ``result`` and ``verdict_result`` are JSON: ``result`` is what the operation stored, ``verdict_result`` what
its verdict reported. ``body`` is the whole row as the journal has it, canonical MessagePack; ``hash`` is its hash, 32
bytes.
"""
JSON_COLUMNS: Final = frozenset(_JSON)
"""Columns that hold JSON."""
_AT_ONCE: Final = 1000
"""Number of rows that are Python objects at once: the garbage collector looks at all of them again and again, which
makes 20,000 at once half as fast."""
_FROM_ROWS: Final = tuple(name for name in _FIELDS if name not in (*_NAME, "time"))

_encode: Final = msgspec.json.Encoder(order="sorted").encode


def table_of(journal: JournalName, rows: Iterable[ProvenRow]) -> pa.Table:
    """Return rows of a journal as a table with the columns of `SCHEMA`.

    Args:
        journal: Name of the journal.
        rows: The rows, in order; at least one.
    """
    values, parts = map(_values, rows), []
    while part := list(islice(values, _AT_ONCE)):
        parts.append(_part(journal, part))
    return pa.concat_tables(parts)


def _part(journal: JournalName, rows: Sequence[tuple[Any, ...]]) -> pa.Table:
    columns = dict(zip(_FROM_ROWS, zip(*rows, strict=True), strict=True))
    names = zip(_NAME, (*journal[:3], str(journal)), strict=True)
    arrays = {name: pa.repeat(value, len(rows)) for name, value in names}
    for name, values in columns.items():
        # The encoder returns bytes; decoding them in Arrow saves a Python object for each value.
        plain = pa.array(values, pa.binary() if name in _JSON else _FIELDS[name])
        arrays[name] = plain.cast(pa.string()) if name in _JSON else plain
    microseconds = pc.round(pc.multiply(arrays["wall"], 1e6)).cast(pa.int64())
    arrays["time"] = microseconds.cast(pa.timestamp("us"))
    return pa.table([arrays[name] for name in _FIELDS], schema=SCHEMA)


def end_of(table: pa.Table) -> RowPosition:
    """Return the position of the last row of a table."""
    return RowPosition(table.column("sequence")[-1].as_py(), table.column("hash")[-1].as_py())


def check_table(segment: Segment, table: pa.Table) -> None:
    """Require that a table holds the rows of a segment and nothing else.

    The hashes are computed again from the bodies, and all other columns are derived from them again: a change of any
    column is found.

    Args:
        segment: The segment.
        table: Table that was read from the archive.

    Raises:
        AlteredSegmentError: A row was altered; the field ``first`` is its sequence, if one row can be named.
    """
    if table.schema != SCHEMA or not table.num_rows or table.num_rows != segment.rows:
        what = f"{segment} has {table.num_rows} rows and {table.num_columns} columns"
        raise altered(
            segment.journal, segment.first, segment.last, f"{what}, {segment.rows} and {len(SCHEMA)} belong there"
        )
    bodies, hashes = (table.column(name).to_pylist() for name in ("body", "hash"))
    expected = table_of(segment.journal, _rows(segment, bodies, hashes))
    if end_of(expected) != segment.end:
        raise altered(segment.journal, segment.first, segment.last, f"{segment} ends with another hash than it had")
    wrong = [name for name in SCHEMA.names if not table.column(name).equals(expected.column(name))]
    if wrong:
        what = f"{', '.join(wrong)} in {segment} differ from the rows' bodies"
        raise altered(segment.journal, segment.first, segment.last, what)


def _rows(segment: Segment, bodies: Sequence[Any], hashes: Sequence[Any]) -> Iterator[ProvenRow]:
    """Yield the rows of a segment from their bodies, whose hashes must be those beside them."""
    own = segment.start.hash
    for sequence, (body, stored) in enumerate(zip(bodies, hashes, strict=True), start=segment.first):
        try:
            own = chain_hash(own, sequence, body)
            row = decode_row(body)
        except (JournalError, TypeError, OverflowError) as error:  # the last one for a negative sequence
            raise altered(segment.journal, sequence, sequence, f"the row in {segment} cannot be read") from error
        if own != stored:
            raise altered(segment.journal, sequence, sequence, f"the row in {segment} does not match its hash")
        yield ProvenRow(sequence, row, body, own)


def _json(value: object) -> bytes | None:
    return None if value is None else _encode(value)


def _values(proven: ProvenRow) -> tuple[Any, ...]:
    """Return the values of `_FROM_ROWS`, in their order."""
    row, verdict = proven.row, proven.row.verdict
    decision = reason = text = state = reported = None
    if verdict is not None:
        decision, state, reported = verdict.decision, verdict.state, verdict.result
        if verdict.reason is not None:
            reason, text = verdict.reason.code, verdict.reason.text
    return (
        *(proven.sequence, row.wall, row.monotonic),
        *(row.kind, row.source, row.command_id, row.user, row.role, row.branch, row.operation),
        *(decision, reason, text, state),
        *(_json(row.arguments), _json(row.states), _json(row.result), _json(reported)),
        *(row.parent, row.session_id, row.boot_id),
        *(row.blueprint.id, row.blueprint.version, row.blueprint.hash),
        *(proven.body, proven.hash),
    )
