"""A journal as an older version of the program would have left it."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from pcmrs.journal import JournalReader
from pcmrs.journal.rows import GENESIS, chain_hash, encode_row
from pcmrs.journal.schema import HEADLESS, statements
from pcmrs_lab.campaign.sham import is_sham

INSERT = "INSERT INTO journal VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)"
KINDS = ("intent", "outcome", "device")
"""Rows that version 1 had; those of kind config and snapshot came later."""


def as_version_1(path: Path) -> int:
    """Replaces a closed journal by one of version 1 with the same decisions: no head, no key; returns its rows.

    In a sham campaign the journal stays as it is.
    """
    with JournalReader(path) as reader:
        rows = [stored.row for stored in reader.read() if stored.row.kind in KINDS]
    if is_sham():
        return len(rows)
    for file in (*path.parent.glob(f"{path.name}*"), *path.parent.glob("journal.*")):
        file.unlink()
    with closing(sqlite3.connect(path)) as old, old:
        for statement in statements(HEADLESS).values():
            old.execute(statement)
        previous = GENESIS
        for sequence, row in enumerate(rows, 1):
            body = encode_row(row)
            own = chain_hash(previous, sequence, body)
            keys = (row.kind, row.source, row.command_id, row.branch, row.wall)
            old.execute(INSERT, (sequence, *keys, body, previous, own))
            previous = own
        old.execute(f"PRAGMA user_version = {HEADLESS}")
    return len(rows)
