"""Rows after the last one that the head names: added without the key, or left there by a crash."""

from __future__ import annotations

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

from pcmrs.journal import JournalRow
from pcmrs.journal.head import head_path
from pcmrs.journal.rows import chain_hash, encode_row
from pcmrs.journal.schema import WITHOUT_MAC, version_of
from pcmrs.journal.writer import JournalWriter


def append_without_key(file: Path, rows: Sequence[JournalRow], *, mac: object = None) -> None:
    """Adds rows to a file of a journal as somebody does who knows the format: chained, and found by their commands.

    Args:
        file: Of the journal, and the newest.
        rows: To be added.
        mac: Put into each of them where the version has MACs.
    """
    with closing(sqlite3.connect(file)) as connection, connection:
        end = "SELECT sequence, hash FROM journal ORDER BY sequence DESC LIMIT 1"
        sequence, previous = connection.execute(end).fetchone()
        macs = () if version_of(connection) <= WITHOUT_MAC else (mac,)
        for row in rows:
            sequence += 1
            body = encode_row(row)
            own = chain_hash(previous, sequence, body)
            keys = (row.kind, row.source, row.command_id, row.branch, row.wall)
            values = (sequence, *keys, body, previous, own, *macs)
            connection.execute(f"INSERT INTO journal VALUES ({', '.join('?' * len(values))})", values)  # noqa: S608  # values are bound
            previous = own


def leave_unnamed(journal: Path, rows: Sequence[JournalRow]) -> None:
    """Writes rows with the key and sets the head back: what a crash between the commit and the head leaves."""
    before = head_path(journal).read_bytes()
    writer = JournalWriter(journal, durable=False)
    writer.write([(row, encode_row(row)) for row in rows])
    writer.close()
    head_path(journal).write_bytes(before)
