"""Messages in a stream of bytes between two processes, each behind its length of four bytes."""

from __future__ import annotations

import struct

from pcmrs.errors import PayloadError

LARGEST = 1 << 26
"""Bytes of one message, unless there are fewer by agreement; a longer one is no message of ours."""
_LENGTH = struct.Struct(">I")
LENGTH_SIZE = _LENGTH.size


def framed(body: bytes) -> bytes:
    """The message behind its length."""
    return _LENGTH.pack(len(body)) + body


def length_of(header: bytes) -> int:
    """The length that `LENGTH_SIZE` bytes say."""
    (length,) = _LENGTH.unpack(header)
    return int(length)


class Cutter:
    """Cuts a stream of bytes into messages; survives any split of them.

    Args:
        largest: Bytes of one message.
    """

    def __init__(self, largest: int = LARGEST) -> None:
        self._largest = largest
        self._begun = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """The messages that `data` completes, without their lengths.

        Raises:
            PayloadError: One is longer than there can be.
        """
        self._begun += data
        found, at = [], 0
        while len(self._begun) - at >= LENGTH_SIZE:
            (length,) = _LENGTH.unpack_from(self._begun, at)
            if length > self._largest:
                raise PayloadError(f"A message of {length} bytes; there are {self._largest} at most.", length=length)
            end = at + LENGTH_SIZE + length
            if len(self._begun) < end:
                break
            found.append(bytes(self._begun[at + LENGTH_SIZE : end]))
            at = end
        del self._begun[:at]
        return found
