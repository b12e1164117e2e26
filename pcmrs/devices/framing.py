"""Framing of messages in a stream of bytes between two processes: each follows its length in four bytes."""

from __future__ import annotations

import struct

from pcmrs.errors import PayloadError

LARGEST = 1 << 26
"""Default limit of the length of one message, bytes."""
_LENGTH = struct.Struct(">I")
LENGTH_SIZE = _LENGTH.size
"""Size of the length field, bytes."""


def framed(body: bytes) -> bytes:
    """Return a message with its length in front."""
    return _LENGTH.pack(len(body)) + body


def length_of(header: bytes) -> int:
    """Return the length in a header of `LENGTH_SIZE` bytes."""
    (length,) = _LENGTH.unpack(header)
    return int(length)


class MessageSplitter:
    """Splitter of a stream of bytes into messages, however the stream is cut into pieces.

    Args:
        largest: Limit of the length of one message, bytes.
    """

    def __init__(self, largest: int = LARGEST) -> None:
        self._largest = largest
        self._incomplete = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Return the messages that `data` completes, without their lengths.

        Raises:
            PayloadError: A message is longer than the limit.
        """
        self._incomplete += data
        found, at = [], 0
        while len(self._incomplete) - at >= LENGTH_SIZE:
            (length,) = _LENGTH.unpack_from(self._incomplete, at)
            if length > self._largest:
                raise PayloadError(f"A message has {length} bytes, the limit is {self._largest}.", length=length)
            end = at + LENGTH_SIZE + length
            if len(self._incomplete) < end:
                break
            found.append(bytes(self._incomplete[at + LENGTH_SIZE : end]))
            at = end
        del self._incomplete[:at]
        return found
