"""The signed head: the last row of the journal, stored outside its database, so that a lost tail is detected.

A hash chain shows changes inside it, but a chain that ends early is still valid. The head names the last row that may
have been acknowledged. It is signed, so that without the key the journal cannot be shortened undetected.
"""

from __future__ import annotations

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from pcmrs.errors import JournalError
from pcmrs.files import write_durably
from pcmrs.journal.keys import signed_by
from pcmrs.journal.rows import START, RowPosition

_MAGIC: Final = b"PCMRSJH1"
_SIGNED: Final = struct.Struct(">8sQQ32s")
"""Magic, counter, sequence and hash of the row."""
_SIGNATURE: Final = 64
_SLOT: Final = 4096
"""Size of a slot, bytes. Each has its own sectors: a torn write of one leaves the other whole."""
SLOTS: Final = 2


@dataclass(frozen=True, slots=True)
class Head:
    """Content of one slot.

    Attributes:
        counter: Number of the write, increased by one each time.
        place: Position of the last row that may have been acknowledged.
    """

    counter: int
    place: RowPosition

    def pack(self, key: Ed25519PrivateKey) -> bytes:
        """Return the signed bytes of a slot."""
        message = _SIGNED.pack(_MAGIC, self.counter, self.place.sequence, self.place.hash)
        return message + key.sign(message)


@dataclass(frozen=True, slots=True)
class HeadState:
    """Content of a head file.

    Attributes:
        head: Newest slot with a valid signature; None if there is none.
        damaged: Number of slots that are incomplete or not signed by the key.
    """

    head: Head | None
    damaged: int


def head_path(journal: Path) -> Path:
    """Return the path of a journal's head."""
    return journal.with_name(journal.name + ".head")


def read_head(path: Path, key: Ed25519PublicKey) -> HeadState | None:
    """Return the content of a head file; None if there is no such file.

    Args:
        path: Head file.
        key: Public key that verifies it.

    Raises:
        JournalError: The file cannot be read.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise JournalError(f"{path} cannot be read: {error.strerror}.", path=str(path)) from error
    return parse_head(content, key)


def parse_head(content: bytes, key: Ed25519PublicKey) -> HeadState:
    """Return what the bytes of a head file say.

    Args:
        content: Bytes of both slots.
        key: Public key that verifies them.
    """
    slots = [_unpack(content[start : start + _SIGNED.size + _SIGNATURE], key) for start in (0, _SLOT)]
    whole = [slot for slot in slots if slot is not None]
    return HeadState(max(whole, key=lambda head: head.counter, default=None), SLOTS - len(whole))


def begin_head(path: Path, key: Ed25519PrivateKey, place: RowPosition = START) -> None:
    """Create a head file with both slots.

    Args:
        path: Head file.
        key: Private key that signs it.
        place: Position of the last row.

    Raises:
        OSError: The file cannot be written.
    """
    slots = [Head(counter, place).pack(key).ljust(_SLOT, b"\0") for counter in range(SLOTS)]
    write_durably(path, b"".join(slots), mode=0o644)


class HeadFile:
    """The head of a journal that is open for writing; it locks the journal against other writers.

    Args:
        path: Head file.
        key: Private key that signs it.
        head: Present content.
        durable: True to wait at each write until it is on the disk.

    Raises:
        JournalError: Another process writes this journal, or the file cannot be opened.
    """

    def __init__(self, path: Path, key: Ed25519PrivateKey, head: Head, *, durable: bool) -> None:
        self._key = key
        self._counter = head.counter
        self._durable = durable
        try:
            self._descriptor = os.open(path, os.O_RDWR)
        except OSError as error:
            raise JournalError(f"{path} cannot be written: {error.strerror}.", path=str(path)) from error
        try:
            import fcntl  # not on Windows, where journals can be read but not written

            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(self._descriptor)
            text = f"Another process writes the journal of {path}: stop it, or give another cell.folder."
            raise JournalError(text, path=str(path)) from error

    def write(self, place: RowPosition) -> None:
        """Write the position of the last row into the older slot.

        Raises:
            OSError: The file cannot be written.
        """
        head = Head(self._counter + 1, place)
        slot = head.pack(self._key)
        written = os.pwrite(self._descriptor, slot, head.counter % SLOTS * _SLOT)
        if written != len(slot):
            raise OSError(f"only {written} of {len(slot)} bytes of the head were written")
        if self._durable:
            os.fdatasync(self._descriptor)
        self._counter = head.counter

    def close(self) -> None:
        """Release the lock; a second call does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1


def _unpack(slot: bytes, key: Ed25519PublicKey) -> Head | None:
    message, signature = slot[: _SIGNED.size], slot[_SIGNED.size :]
    if len(signature) != _SIGNATURE or not signed_by(key, signature, message):
        return None
    magic, counter, sequence, own = _SIGNED.unpack(message)
    return Head(counter, RowPosition(sequence, own)) if magic == _MAGIC else None
