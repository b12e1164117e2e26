"""Frames of the TCP link: a stream of bytes is cut at each ``;`` and ends at the first byte that breaks the grammar.

A stream that begins with ``|;`` is signed: a frame of it is a command with its signature,
``<command>;|<peer>|<counter>|<tag>;``. In any other stream each ``;`` ends a frame.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from pcmrs.errors import PayloadError
from pcmrs.gateway.grammar import may_become_command

SIGNS = b"|;"
"""A stream whose commands are signed begins with this."""

_LONGEST_SIGNATURE = 86
_SIGNATURE = re.compile(rb"\|[A-Za-z0-9_|-]*;?")


class Frames:
    """Cuts a stream into frames.

    A browser, or any other program that speaks another protocol, breaks the grammar at its first line. What it sends
    afterwards may look like a command, so the stream has to end at the first wrong byte.
    """

    def __init__(self) -> None:
        self._rest = b""
        self._signed: bool | None = None

    @property
    def unfinished(self) -> bytes:
        """Bytes after the last frame."""
        return self._rest

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield each complete frame, in the form in which a datagram has it.

        Args:
            data: Bytes that have arrived.

        Raises:
            PayloadError: What follows the last frame cannot become one. Nothing after it may be looked at.
        """
        self._rest += data
        while (frame := self._next()) is not None:
            yield frame

    def _next(self) -> bytes | None:
        """Return the next frame; None where it is not complete."""
        if self._signed is None and not self._opened():
            return None
        command, end, behind = self._rest.partition(b";")
        if not may_become_command(command + end):
            raise PayloadError(f"{_shown(self._rest)} cannot become a command; the connection ends.")
        if not end:
            return None
        if not self._signed:
            self._rest = behind
            return command + end
        signature, second_end, behind = behind.partition(b";")
        self._check_signature(signature + second_end)
        if not second_end:
            return None
        self._rest = behind
        return command + end + signature

    def _opened(self) -> bool:
        """Whether it is known that the stream is signed, or that it is not."""
        if not self._rest or (self._rest != SIGNS and SIGNS.startswith(self._rest)):
            return False
        self._signed = self._rest.startswith(SIGNS)
        if self._signed:
            self._rest = self._rest.removeprefix(SIGNS)
        return True

    def _check_signature(self, text: bytes) -> None:
        if text and not (len(text) <= _LONGEST_SIGNATURE + 1 and _SIGNATURE.fullmatch(text)):
            raise PayloadError(
                f"{_shown(self._rest)} has no signature, on a connection that signs; the connection ends."
            )


def _shown(data: bytes) -> str:
    return repr(data[:40])
