"""The framing of NDI's API: commands that end with a carriage return, replies that end with a CRC."""

from __future__ import annotations

import struct
from dataclasses import dataclass

LONGEST_COMMAND = 1024
"""Longest command, bytes. A longer one is cut off and answered as too long."""

INVALID, TOO_LONG, BAD_CRC, PARAMETERS = 0x01, 0x02, 0x04, 0x07
"""Numbers of the errors of commands that cannot be parsed (NDI's API guide, error codes)."""


def crc16(data: bytes) -> int:
    """Return the CRC-16 with reflected polynomial A001 and initial value 0 (NDI's API guide, appendix on the CRC)."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


class CommandError(Exception):
    """A command that is answered with ``ERROR`` and a number.

    Args:
        number: Number of the error in NDI's API guide.
    """

    def __init__(self, number: int) -> None:
        super().__init__(f"ERROR{number:02X}")
        self.number = number


@dataclass(frozen=True)
class NdiCommand:
    """A command.

    Attributes:
        name: Name, such as ``PINIT``.
        parameters: Text of the parameters, without the CRC.
    """

    name: str
    parameters: str


def parse(line: bytes) -> NdiCommand:
    """Parse a command: ``NAME:parametersCRC``, or ``NAME parameters`` without a CRC.

    Args:
        line: The command without its carriage return.

    Raises:
        CommandError: The command is too long, its CRC is wrong, or its name is not made of capitals and digits.
    """
    if len(line) > LONGEST_COMMAND:
        raise CommandError(TOO_LONG)
    if not line.isascii():
        raise CommandError(INVALID)
    name, colon, rest = line.decode("ascii").partition(":")
    if not colon:
        name, _, rest = name.partition(" ")
    elif rest[-4:] != f"{crc16(line[:-4]):04X}":
        raise CommandError(BAD_CRC)
    else:
        rest = rest[:-4]
    if not (name.isalnum() and name == name.upper()):
        raise CommandError(INVALID)
    return NdiCommand(name, rest)


def reply(text: str) -> bytes:
    """Return a reply in text, with its CRC and a carriage return."""
    data = text.encode("ascii")
    return data + f"{crc16(data):04X}\r".encode("ascii")


def binary_reply(body: bytes) -> bytes:
    """Return a reply to ``BX``: start sequence, length and their CRC, then the body and its CRC, all little-endian."""
    header = struct.pack("<HH", 0xA5C4, len(body))
    return header + struct.pack("<H", crc16(header)) + body + struct.pack("<H", crc16(body))


class Lines:
    """Splitter of a stream of bytes into commands. It holds at most one command of the longest length."""

    def __init__(self) -> None:
        self._partial = b""

    def feed(self, data: bytes) -> list[bytes]:
        """Return the commands that `data` completes, without their carriage returns. Line feeds are ignored."""
        *complete, partial = (self._partial + data.replace(b"\n", b"")).split(b"\r")
        self._partial = partial[: LONGEST_COMMAND + 1]  # one byte more than allowed marks it as too long
        return complete
