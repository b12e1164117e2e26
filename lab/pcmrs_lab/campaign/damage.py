"""Damage to a journal: a removed or cut file, a flipped bit, rows without a key, or the format of an older version.

Rows after the last one that the head names are either added without the key or left there by a crash.
"""

from __future__ import annotations

import random
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path

import msgspec

from pcmrs.journal import JournalReader, JournalRow
from pcmrs.journal.head import head_path
from pcmrs.journal.rows import GENESIS, chain_hash, encode_row
from pcmrs.journal.schema import HEADLESS, WITHOUT_MAC, statements, version_of
from pcmrs.journal.writer import JournalWriter
from pcmrs.testing.journal import HEAD, NAME, contents
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


def append_without_key(file: Path, rows: Sequence[JournalRow], *, mac: object = None) -> None:
    """Append rows to a file of a journal as an attacker does who knows the format.

    The rows are chained, and found by their commands.

    Args:
        file: Newest file of the journal.
        rows: Rows to append.
        mac: Value of the MAC in each row, if the version has MACs.
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


def append_past_head(journal: Path, rows: Sequence[JournalRow]) -> None:
    """Write rows with the key and restore the old head, as a crash between commit and head update leaves them.

    Args:
        journal: Database file of the journal.
        rows: Rows to append.
    """
    before = head_path(journal).read_bytes()
    writer = JournalWriter(journal, durable=False)
    writer.write([(row, encode_row(row)) for row in rows])
    writer.close()
    head_path(journal).write_bytes(before)


TAIL = 2048
"""Number of bytes at the end of database and log that are damaged one by one."""

TAILED = (NAME, f"{NAME}-wal", HEAD)
"""Files of which the end is damaged."""


class Damage(msgspec.Struct, frozen=True):
    """Change of one file: it is cut before `place`, or the bit `flip` of the byte there is inverted.

    Attributes:
        file: Name of the file.
        place: Offset in the file, bytes; -1 to remove it.
        flip: Number of a bit, from 0; None for a cut.
    """

    file: str
    place: int
    flip: int | None = None

    def apply(self, folder: Path) -> None:
        """Change the file in the folder; do nothing in a sham campaign."""
        if is_sham():
            return
        path = folder / self.file
        content = bytearray(path.read_bytes())
        if self.flip is not None:
            content[self.place] ^= 1 << self.flip
        elif self.place < 0:
            path.unlink()
            return
        else:
            del content[self.place :]
        path.write_bytes(content)

    def __str__(self) -> str:
        if self.flip is not None:
            return f"{self.file} bit {self.flip} flipped in byte {self.place}"
        return f"{self.file} removed" if self.place < 0 else f"{self.file} cut at byte {self.place}"


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
