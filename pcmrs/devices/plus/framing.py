"""OpenIGTLink messages out of a TCP stream, however it is cut into segments."""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Collection
from typing import Any

from pyigtl.messages import MessageBase

from pcmrs.devices.plus.messages import unpack

HEADER_BYTES = 58
MAX_BODY = 1 << 20
"""Longest body that is read, bytes; a longer one is skipped, whatever it holds."""
CHUNK = 1 << 16

_SIZE_AND_CRC = struct.Struct(">QQ")


class MessageReader:
    """Reads messages one after the other; a read that is cancelled loses nothing.

    Args:
        stream: The bytes.
        kinds: Types that are read, such as ``TRANSFORM``; all others are skipped.
    """

    def __init__(self, stream: asyncio.StreamReader, kinds: Collection[str]) -> None:
        self._stream = stream
        self._kinds = kinds
        self._header: bytes | None = None
        self._left_to_skip = 0

    async def read(self) -> Any | None:
        """The next message, as `pyigtl` has it; None for one of another type.

        Raises:
            PayloadError: A message is damaged; the next one can be read.
            ConnectionError: What comes is no OpenIGTLink, so that nothing behind it can be read.
            asyncio.IncompleteReadError: The other side has closed.
        """
        if self._left_to_skip:
            await self._skip()
            return None
        if self._header is None:
            self._header = await self._stream.readexactly(HEADER_BYTES)
        header, (size, crc) = _parse(self._header), _SIZE_AND_CRC.unpack_from(self._header, 42)
        if header["message_type"] not in self._kinds or size > MAX_BODY:
            self._header, self._left_to_skip = None, size
            await self._skip()
            return None
        body = await self._stream.readexactly(size)
        self._header = None
        return unpack(header, crc, body)

    async def _skip(self) -> None:
        while self._left_to_skip:
            data = await self._stream.read(min(self._left_to_skip, CHUNK))
            if not data:
                raise asyncio.IncompleteReadError(b"", self._left_to_skip)
            self._left_to_skip -= len(data)


def _parse(header: bytes) -> dict[str, Any]:
    try:
        fields: dict[str, Any] = MessageBase.parse_header(header)
    except UnicodeDecodeError:
        fields = {"header_version": None}
    if fields["header_version"] not in (1, 2):
        raise ConnectionAbortedError("what came is no OpenIGTLink header of version 1 or 2")
    return fields
