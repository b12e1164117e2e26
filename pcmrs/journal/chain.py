"""The hash chain through the stored rows, and the message authentication code (MAC) of each row.

Hashes alone do not show who wrote a row: anyone can compute them. The signature of the head proves the rows up to the
one that it names. After a crash, rows may follow it; their MACs show that they were written with the key and not added
without it, and the next start adopts them.
"""

from __future__ import annotations

import hmac
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from pcmrs.errors import JournalError
from pcmrs.journal.rows import START, JournalRow, RowPosition, StoredRow, chain_hash, decode_row
from pcmrs.journal.schema import DATABASE_ERRORS, WITHOUT_MAC, version_of

COLUMNS: Final = "sequence, body, previous_hash, hash"
_ALL_COLUMNS: Final = f"{COLUMNS}, kind, source, command_id, branch, wall"

REMEDY: Final = (
    "`pcmrs journal verify` shows what is good, `pcmrs journal export --good-part` saves it; keep the files unchanged "
    "and continue in another cell.folder."
)
"""Advice for a damaged journal."""


def stored_row(path: Path, record: tuple[Any, ...]) -> StoredRow:
    """Return the row of a database record.

    Args:
        path: Journal file, for the message.
        record: Values of `COLUMNS`.

    Raises:
        JournalError: The bytes do not match the hash that is stored with them; the field ``sequence`` names the row.
    """
    sequence, body, previous, own = record
    if not (isinstance(sequence, int) and sequence > 0 and all(isinstance(each, bytes) for each in record[1:])):
        raise _damaged(path, sequence, "does not have the content of a row")
    if own != chain_hash(previous, sequence, body):
        raise _damaged(path, sequence, "does not match its hash")
    try:
        row = decode_row(body)
    except JournalError as error:
        raise _damaged(path, sequence, f"cannot be read ({error.text})") from error
    return StoredRow(sequence=sequence, row=row, previous_hash=previous, hash=own)


def follow_chain(connection: sqlite3.Connection, path: Path, after: RowPosition | int = START) -> Iterator[StoredRow]:
    """Yield the rows after a position, in order, and check that each is whole, chained and found by its command.

    Args:
        connection: Connection to the journal file.
        path: Journal file, for the messages.
        after: Position after which to start; a sequence alone to trust its hash.

    Raises:
        JournalError: A row is missing, changed or unreadable; the field ``sequence`` names it.
    """
    expected, previous = (after, None) if isinstance(after, int) else (after.sequence, after.hash)
    query = f"SELECT {_ALL_COLUMNS} FROM journal WHERE sequence > ? ORDER BY sequence"  # noqa: S608  # constants
    try:
        for record in connection.execute(query, (expected,)):
            expected += 1
            if record[0] != expected:
                raise _damaged(path, expected, f"is missing; the next is {record[0]}")
            stored = stored_row(path, record[:4])
            if previous is not None and stored.previous_hash != previous:
                raise _damaged(path, expected, "does not follow from the row before it")
            _check_keys(connection, path, stored.row, record)
            previous = stored.hash
            yield stored
    except DATABASE_ERRORS as error:
        raise _damaged(path, expected + 1, f"cannot be read ({error})") from error


def follow_files(
    files: Iterable[tuple[Path, sqlite3.Connection]], after: RowPosition | int = START
) -> Iterator[StoredRow]:
    """Yield the rows of several files; see `follow_chain`.

    Args:
        files: Path and connection of each file, in order.
        after: Position in the first file after which to start.
    """
    for path, connection in files:
        for stored in follow_chain(connection, path, after):
            after = RowPosition(stored.sequence, stored.hash)
            yield stored


def starts_of(files: Sequence[tuple[Path, sqlite3.Connection]]) -> list[RowPosition]:
    """Return the position before the first row of each file, which is the end of the file before it.

    Raises:
        JournalError: A file does not start where the one before it ends.
    """
    starts = [START]
    for (earlier, before), (path, connection) in pairwise(files):
        end = _position(earlier, before, "SELECT sequence, hash FROM journal ORDER BY sequence DESC LIMIT 1")
        start = _position(path, connection, "SELECT sequence - 1, previous_hash FROM journal ORDER BY sequence LIMIT 1")
        if start != end:
            text = f"does not follow from the end of {earlier.name}, which is row {end.sequence}"
            raise _damaged(path, start.sequence + 1, text)
        starts.append(start)
    return starts


def _position(path: Path, connection: sqlite3.Connection, query: str) -> RowPosition:
    try:
        found = connection.execute(query).fetchone()
    except DATABASE_ERRORS as error:
        raise _damaged(path, 0, f"cannot be read ({error})") from error
    return START if found is None else RowPosition(*found)


def _check_keys(connection: sqlite3.Connection, path: Path, row: JournalRow, record: tuple[Any, ...]) -> None:
    """Require that the columns and indexes lead to the row: repeats and unfinished commands are found by them."""
    if record[4:] != (row.kind, row.source, row.command_id, row.branch, row.wall):
        raise _damaged(path, record[0], "is stored under wrong keys")
    if row.command_id is None or row.source is None or row.kind not in ("intent", "outcome"):
        return
    query = (
        f"SELECT sequence FROM journal INDEXED BY one_{row.kind} "  # noqa: S608  # the kind is one of a few
        f"WHERE kind = '{row.kind}' AND source = ? AND command_id = ?"
    )
    if connection.execute(query, (row.source, row.command_id)).fetchall() != [(record[0],)]:
        raise _damaged(path, record[0], "is not found by its command")


def _damaged(path: Path, sequence: object, what: str) -> JournalError:
    return JournalError(f"{path} is damaged: row {sequence} {what}. {REMEDY}", path=str(path), sequence=sequence)


_LABEL: Final = b"PCMRS journal row MAC 1"


def mac_key(key: Ed25519PrivateKey) -> bytes:
    """Return the key of the rows' MACs, derived from the private key that signs the head."""
    return HKDF(SHA256(), length=32, salt=None, info=_LABEL).derive(key.private_bytes_raw())


def row_mac(key: bytes, own_hash: bytes) -> bytes:
    """Return the HMAC-SHA256 of a row's hash, which covers the row, its sequence and all rows before it.

    Args:
        key: Key from `mac_key`.
        own_hash: Hash of the row.
    """
    return hmac.digest(key, own_hash, "sha256")


def first_without_mac(files: Iterable[tuple[Path, sqlite3.Connection]], after: int, key: bytes) -> int | None:
    """Return the sequence of the first row without a valid MAC; None if all have one.

    Args:
        files: Path and connection of each file, in order.
        after: Sequence after which rows are checked.
        key: Key from `mac_key`.

    Raises:
        JournalError: A file cannot be read.
    """
    for path, connection in files:
        try:
            mac = "NULL" if version_of(connection) <= WITHOUT_MAC else "mac"
            query = f"SELECT sequence, hash, {mac} FROM journal WHERE sequence > ? ORDER BY sequence"  # noqa: S608  # ours
            for sequence, own, found in connection.execute(query, (after,)):
                if not (isinstance(found, bytes) and hmac.compare_digest(found, row_mac(key, own))):
                    return int(sequence)
        except DATABASE_ERRORS as error:
            raise JournalError(f"{path} cannot be read: {error}.", path=str(path)) from error
    return None
