"""The signed head: how far the journal goes, kept outside its database, so that a lost tail is seen.

A hash chain shows what was changed in it, but a chain that ends early is a whole chain. The head names the last row
that may have been acknowledged, and is signed, so that nobody without the key can shorten the journal unseen.
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
from pcmrs.journal.rows import START, Place

_MAGIC: Final = b"PCMRSJH1"
_SIGNED: Final = struct.Struct(">8sQQ32s")
"""Magic, counter, sequence and hash of the row."""
_SIGNATURE: Final = 64
_SLOT: Final = 4096
"""The slots lie in sectors of their own: a torn write of one leaves the other whole."""
SLOTS: Final = 2


@dataclass(frozen=True, slots=True)
class Head:
    """What one slot says.

    Attributes:
        counter: Grows by one with every write.
        place: The last row that may have been acknowledged.
    """

    counter: int
    place: Place

    def pack(self, key: Ed25519PrivateKey) -> bytes:
        """The bytes of a slot."""
        message = _SIGNED.pack(_MAGIC, self.counter, self.place.sequence, self.place.hash)
        return message + key.sign(message)


@dataclass(frozen=True, slots=True)
class HeadState:
    """What the file of a head says.

    Attributes:
        head: The newest slot whose signature holds; None when there is none.
        damaged: How many of the slots are not whole or not signed by the key.
    """

    head: Head | None
    damaged: int


def head_path(journal: Path) -> Path:
    """Where the head of a journal is kept."""
    return journal.with_name(journal.name + ".head")


def read_head(path: Path, key: Ed25519PublicKey) -> HeadState | None:
    """The head in a file; None when there is no such file.

    Raises:
        JournalError: It cannot be read.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise JournalError(f"{path} cannot be read: {error.strerror}.", path=str(path)) from error
    slots = [_unpack(content[start : start + _SIGNED.size + _SIGNATURE], key) for start in (0, _SLOT)]
    whole = [slot for slot in slots if slot is not None]
    return HeadState(max(whole, key=lambda head: head.counter, default=None), SLOTS - len(whole))


def begin_head(path: Path, key: Ed25519PrivateKey, place: Place = START) -> None:
    """Makes the file of a head, with both slots. Raises `OSError`."""
    slots = [Head(counter, place).pack(key).ljust(_SLOT, b"\0") for counter in range(SLOTS)]
    write_durably(path, b"".join(slots), mode=0o644)


class HeadFile:
    """Writes the head of a journal that is open for writing; nobody else may write it meanwhile.

    Args:
        durable: Whether a write waits until the disk has it.

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
            import fcntl  # who only reads a journal does so on Windows, too

            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(self._descriptor)
            text = f"Another process writes the journal of {path}: stop it, or give another cell.folder."
            raise JournalError(text, path=str(path)) from error

    def write(self, place: Place) -> None:
        """Names the last row, in the slot that is older. Raises `OSError`."""
        head = Head(self._counter + 1, place)
        slot = head.pack(self._key)
        written = os.pwrite(self._descriptor, slot, head.counter % SLOTS * _SLOT)
        if written != len(slot):
            raise OSError(f"only {written} of {len(slot)} bytes of the head were written")
        if self._durable:
            os.fdatasync(self._descriptor)
        self._counter = head.counter

    def close(self) -> None:
        """Lets others write; closing again does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1


def _unpack(slot: bytes, key: Ed25519PublicKey) -> Head | None:
    message, signature = slot[: _SIGNED.size], slot[_SIGNED.size :]
    if len(signature) != _SIGNATURE or not signed_by(key, signature, message):
        return None
    magic, counter, sequence, own = _SIGNED.unpack(message)
    return Head(counter, Place(sequence, own)) if magic == _MAGIC else None
