"""Places at which a campaign damages a journal, and a journal in the format of an older version."""

from __future__ import annotations

import random
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

from pcmrs.journal import JournalReader
from pcmrs.journal.rows import GENESIS, chain_hash, encode_row
from pcmrs.journal.schema import HEADLESS, statements
from pcmrs.testing.journal import HEAD, NAME, Damage, contents
from pcmrs_lab.campaign.sham import is_sham

INSERT = "INSERT INTO journal VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)"
KINDS = ("intent", "outcome", "device")
"""Kinds of rows in version 1; config and snapshot came later."""


def as_version_1(path: Path) -> int:
    """Replace a closed journal by one of version 1 with the same decisions; return the number of rows.

    Version 1 has no head and no key. The journal is unchanged in a sham campaign.
    """
    with JournalReader(path) as reader:
        rows = [stored.row for stored in reader.read() if stored.row.kind in KINDS]
    if is_sham():
        return len(rows)
    for file in {*path.parent.glob(f"{path.name}*"), *path.parent.glob("journal.*")}:
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


TAIL = 2048
"""Number of bytes at the end of database and log that are damaged one by one."""

TAILED = (NAME, f"{NAME}-wal", HEAD)
"""Files of which the end is damaged."""


def damages(
    wholes: Sequence[Path], count: int | None, generator: random.Random, *, flips: bool
) -> list[tuple[Path, Damage]]:
    """Return damages of the journals in these folders, each with its folder.

    Args:
        wholes: Folders of one undamaged journal each.
        count: Number of random damages, in any file; None for every byte of the head's slots and of the tails of the
            others.
        generator: Source of randomness.
        flips: True to flip bits, False to cut files.
    """
    first = 0 if flips else -1
    if count is None:
        places = [(whole, file, place) for whole in wholes for file, place in _tails(whole)]
    else:
        files = [(whole, file, len(content)) for whole in wholes for file, content in sorted(contents(whole).items())]
        files = [each for each in files if each[2] > first]  # an empty file has no bit
        chosen = [generator.choice(files) for _ in range(count)]
        places = [(whole, file, generator.randrange(first, length)) for whole, file, length in chosen]
    return [(whole, Damage(file, place, generator.randrange(8) if flips else None)) for whole, file, place in places]


def _tails(folder: Path) -> Iterator[tuple[str, int]]:
    for name in TAILED:
        content = (folder / name).read_bytes() if (folder / name).exists() else b""
        if name == HEAD:
            yield from ((name, place) for place, byte in enumerate(content) if byte)  # the rest is padding
        else:
            yield from ((name, place) for place in range(max(0, len(content) - TAIL), len(content)))
