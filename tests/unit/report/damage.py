"""Damage to a journal."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path


def turn_bit(journal: Path, sequence: int) -> None:
    """Of the row's hash, where it lies in the file beside that of the row before it."""
    with closing(sqlite3.connect(journal)) as database:
        query = "SELECT previous_hash, hash FROM journal WHERE sequence = ?"
        hashes = b"".join(database.execute(query, (sequence,)).fetchone())
    whole = bytearray(journal.read_bytes())
    assert whole.count(hashes) == 1
    whole[whole.find(hashes) + 40] ^= 1
    journal.write_bytes(whole)
