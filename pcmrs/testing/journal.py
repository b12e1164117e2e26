"""Files of a journal: writing them into a folder and reading them back, rows to fill one with, and its damage.

Rows after the last one that the head names are either added without the key or left there by a crash.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path

import msgspec

from pcmrs.journal import JournalRow
from pcmrs.journal.head import head_path
from pcmrs.journal.rows import chain_hash, encode_row
from pcmrs.journal.schema import WITHOUT_MAC, version_of
from pcmrs.journal.writer import JournalWriter
from pcmrs.messages import BlueprintTag

__all__ = [
    "HEAD",
    "KEY",
    "NAME",
    "PUBLIC_KEY",
    "Damage",
    "append_past_head",
    "append_without_key",
    "contents",
    "place",
    "row",
]

NAME = "journal.sqlite"
"""Name of the database file."""
HEAD = f"{NAME}.head"
"""Name of the file of the head."""
KEY = "journal.key"
"""Name of the file of the private key."""
PUBLIC_KEY = "journal.pub"
"""Name of the file of the public key."""

TAG = BlueprintTag(id="testing", version="1", hash="0" * 16)


def place(files: Mapping[str, bytes], folder: Path) -> Path:
    """Write files into a new folder, and return the path of the journal in it.

    Args:
        files: Content of each file by name.
        folder: Folder to make.
    """
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    if KEY in files:
        (folder / KEY).chmod(0o600)
    return folder / NAME


def contents(folder: Path) -> dict[str, bytes]:
    """Return the content of all files in a folder by name, except SQLite's shared memory, which a reboot removes."""
    return {path.name: path.read_bytes() for path in folder.iterdir() if not path.name.endswith("-shm")}


def row(run: str, writer: int, number: int) -> JournalRow:
    """Return a row that contains its session, writer and number.

    Args:
        run: Session id.
        writer: Number of the writer.
        number: Number of the row.
    """
    return JournalRow(
        kind="event",
        wall=0.0,
        monotonic=0.0,
        boot_id="",
        session_id=run,
        blueprint=TAG,
        source=f"writer{writer}",
        operation=str(number),
        arguments={"filling": "x" * (number % 700)},
    )


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
        """Change the file in the folder."""
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
