"""Newest counter of each signed peer, on disk: a command is accepted once only, also across restarts."""

from __future__ import annotations

import asyncio
import hashlib
import os
import struct
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

import msgspec

from pcmrs.errors import ConfigurationError
from pcmrs.files import write_durably

MOST_NAMES: Final = 128
"""Limit of peers in the file, including those no longer configured: if one returns, nothing may be replayed."""

_MAGIC: Final = b"PCMRSPC1"
_HEADER: Final = struct.Struct(">8sQI")
"""Magic, number of the write and length of the table; the table follows as JSON, then the hash of all."""
_HASH: Final = hashlib.sha256().digest_size
_SLOT: Final = 8192
"""Size of each of the two slots, bytes: a torn write of one leaves the other whole."""

_table = msgspec.json.Decoder(dict[str, int])


class CounterFile:
    """File of counters; written by one thread at a time.

    Args:
        path: The file. It is created if it does not exist.

    Attributes:
        kept: Newest counter of each peer when the file was opened.
        made: The file was created now, so that every peer begins at 0.

    Raises:
        ConfigurationError: The file cannot be created, read or written, or none of its slots is whole.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self.made = not path.exists()
            if self.made:
                path.parent.mkdir(parents=True, exist_ok=True)
                write_durably(path, b"".join(_slot(number, {}) for number in range(2)), mode=0o600)
            self._descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
            slots = [os.pread(self._descriptor, _SLOT, start) for start in (0, _SLOT)]
        except OSError as error:
            text = f"The counters of signed peers, {path}, cannot be used: {error.strerror}."
            raise ConfigurationError(text, file=str(path)) from None
        try:
            self._number, self.kept = _newest(path, slots)
        except ConfigurationError:
            os.close(self._descriptor)
            raise

    def write(self, counters: Mapping[str, int]) -> None:
        """Replace the table, in the older slot; return when the disk has it. Raise `OSError`."""
        slot = _slot(self._number + 1, counters)
        if os.pwrite(self._descriptor, slot, (self._number + 1) % 2 * _SLOT) != len(slot):
            raise OSError(f"only a part of the counters was written to {self._path}")
        os.fdatasync(self._descriptor)
        self._number += 1

    def close(self) -> None:
        """Close the file."""
        os.close(self._descriptor)


def check_counters(path: Path) -> None:
    """Require that this version can read a file of counters, without changing it.

    Raises:
        ConfigurationError: The file cannot be read, is damaged, or a later version wrote it.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigurationError(f"{path} cannot be read: {error.strerror}.", file=str(path)) from None
    _newest(path, [content[start : start + _SLOT] for start in (0, _SLOT)])


def _newest(path: Path, slots: Sequence[bytes]) -> tuple[int, dict[str, int]]:
    """Return number and table of the newest whole slot.

    Args:
        path: The file, for the message.
        slots: Bytes of both slots.

    Raises:
        ConfigurationError: No slot is whole, or a later version wrote the file.
    """
    whole = [read for slot in slots if (read := _read(slot)) is not None]
    later = {slot[: len(_MAGIC)].decode("ascii", "replace") for slot in slots if _is_later(slot)}
    if later and not whole:  # one flipped bit in one slot is no later version
        raise ConfigurationError(
            f"{path} has the format {', '.join(sorted(later))}, and this version of PCMRS reads {_MAGIC.decode()}: use "
            "the version that wrote it, or a later one.",
            file=str(path),
        )
    if not whole:
        raise ConfigurationError(
            f"{path} is damaged, so it does not show which datagrams are old. Remove it, and give every peer a "
            "new key: pcmrs peers new NAME.",
            file=str(path),
        )
    return max(whole, key=lambda slot: slot[0])


def _is_later(slot: bytes) -> bool:
    magic, family = slot[: len(_MAGIC)], _MAGIC[:-1]
    return magic.startswith(family) and magic[len(family) :].isdigit() and magic > _MAGIC


def check_room(kept: Mapping[str, int], peers: Mapping[str, object], path: Path) -> None:
    """Raise `ConfigurationError` if the file has no room for the configured peers.

    Args:
        kept: Counters in the file, by peer.
        peers: The configured peers by name.
        path: The file, for the message.
    """
    names = kept.keys() | peers.keys()
    if len(names) > MOST_NAMES:
        raise ConfigurationError(
            f"{path} would remember {len(names)} peers with those of earlier times, the limit is {MOST_NAMES}. Remove "
            "it, and give every peer a new key: pcmrs peers new NAME.",
            count=len(names),
            limit=MOST_NAMES,
        )


def _slot(number: int, counters: Mapping[str, int]) -> bytes:
    table = msgspec.json.encode(counters)
    content = _HEADER.pack(_MAGIC, number, len(table)) + table
    return (content + hashlib.sha256(content).digest()).ljust(_SLOT, b"\0")


def _read(slot: bytes) -> tuple[int, dict[str, int]] | None:
    """Number and table of a slot; None if it is not whole."""
    if len(slot) < _SLOT:
        return None
    magic, number, length = _HEADER.unpack_from(slot)
    end = _HEADER.size + length
    if magic != _MAGIC or slot[end : end + _HASH] != hashlib.sha256(slot[:end]).digest():
        return None
    return number, _table.decode(slot[_HEADER.size : end])


class CounterWriter:
    """Writer of all counters that wait at once; newer counters of a peer replace older ones.

    Args:
        file: The file. Only the thread of the writer uses it from now on, until the writer is closed.
        failed: Called in the event loop with the error of every write that has failed.
    """

    def __init__(self, file: CounterFile, failed: Callable[[OSError], None]) -> None:
        self._file = file
        self._failed = failed
        self._loop = asyncio.get_running_loop()
        self._newest = dict(file.kept)
        self._waiting: list[asyncio.Future[None]] = []
        self._due = False
        self._closing = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="pcmrs-peer-counters", daemon=True)
        self._thread.start()

    def note(self, peer: str, counter: int) -> None:
        """Write a peer's newest counter, without waiting.

        Args:
            peer: Name of the peer.
            counter: The counter.
        """
        with self._changed:
            self._note(peer, counter)

    def keep(self, peer: str, counter: int) -> asyncio.Future[None]:
        """Write a peer's newest counter.

        Args:
            peer: Name of the peer.
            counter: The counter.

        Returns:
            A future that is done when the disk has the counter, in the order of the calls, or that has the `OSError`.
        """
        stored: asyncio.Future[None] = self._loop.create_future()
        with self._changed:
            self._note(peer, counter)
            self._waiting.append(stored)
        return stored

    async def close(self) -> None:
        """Wait until all counters are written, and cancel the futures that still wait."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        await asyncio.to_thread(self._thread.join)

    def _note(self, peer: str, counter: int) -> None:
        self._newest[peer] = counter
        self._due = True
        self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._due or self._closing)
                if not self._due:
                    return
                newest, waiting = dict(self._newest), self._waiting
                self._waiting, self._due = [], False
            self._loop.call_soon_threadsafe(self._settle, waiting, self._write(newest))

    def _write(self, newest: dict[str, int]) -> OSError | None:
        try:
            self._file.write(newest)
        except OSError as error:
            return error
        return None

    def _settle(self, waiting: list[asyncio.Future[None]], error: OSError | None) -> None:
        if error is not None:
            self._failed(error)
        for stored in waiting:
            if stored.done():
                continue  # its time limit has passed
            if self._closing:
                stored.cancel()
            elif error is None:
                stored.set_result(None)
            else:
                stored.set_exception(error)
