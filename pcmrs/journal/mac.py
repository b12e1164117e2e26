"""A MAC for each row, so that rows after the head that a crash left are told from rows that were added without the key.

Hashes alone do not show who wrote a row: anybody can compute them. Rows up to the one that the head names are proven by
its signature; the MAC proves the ones after it, which the next start takes up.
"""

from __future__ import annotations

import hmac
import sqlite3
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from pcmrs.errors import JournalError
from pcmrs.journal.schema import DATABASE_ERRORS, WITHOUT_MAC, version_of

_LABEL: Final = b"PCMRS journal row MAC 1"


def mac_key(key: Ed25519PrivateKey) -> bytes:
    """The key of the rows' MACs, derived from the private key that signs the head."""
    return HKDF(SHA256(), length=32, salt=None, info=_LABEL).derive(key.private_bytes_raw())


def row_mac(key: bytes, own_hash: bytes) -> bytes:
    """HMAC-SHA256 of a row's hash, which covers the row, its sequence and all rows before it."""
    return hmac.digest(key, own_hash, "sha256")


def first_without_mac(files: Iterable[tuple[Path, sqlite3.Connection]], after: int, key: bytes) -> int | None:
    """Sequence of the first row after a sequence that does not have its MAC; None when all have theirs.

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
