"""The framing of NDI's API: commands that end with a carriage return, replies that end with a CRC."""

from __future__ import annotations

import struct
from dataclasses import dataclass

LONGEST_COMMAND = 1024
"""Bytes; what comes without an end is cut off there and answered as too long."""

INVALID, TOO_LONG, BAD_CRC, PARAMETERS = 0x01, 0x02, 0x04, 0x07
"""Errors of commands that cannot be read."""


def crc16(data: bytes) -> int:
    """CRC-16 with the reflected polynomial A001, begun with 0 (NDI's API guide, appendix on the CRC)."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xA001 if crc & 1 else 0)
    return crc


class CommandError(Exception):
    """A command that is answered with ``ERROR`` and this number."""

    def __init__(self, number: int) -> None:
        super().__init__(f"ERROR{number:02X}")
        self.number = number


@dataclass(frozen=True)
class NdiCommand:
    """A command such as ``PINIT`` with the text of its parameters."""

    name: str
    parameters: str


def parse(line: bytes) -> NdiCommand:
    """Reads a command without its carriage return: ``NAME:parametersCRC``, or ``NAME parameters`` without a CRC.

    Raises:
        CommandError: It is too long, its CRC is wrong, or it holds other characters than text.
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
    """An answer in text: with its CRC and a bare carriage return."""
    data = text.encode("ascii")
    return data + f"{crc16(data):04X}\r".encode("ascii")


def binary_reply(body: bytes) -> bytes:
    """An answer to ``BX``: start sequence, length and their CRC, the body and its CRC, all little-endian."""
    header = struct.pack("<HH", 0xA5C4, len(body))
    return header + struct.pack("<H", crc16(header)) + body + struct.pack("<H", crc16(body))


class Lines:
    """Cuts a stream of bytes into commands; holds no more than one command of the longest length."""

    def __init__(self) -> None:
        self._begun = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The commands that `data` ends, without their carriage returns; line feeds are ignored."""
        *ended, begun = (self._begun + data.replace(b"\n", b"")).split(b"\r")
        self._begun = begun[: LONGEST_COMMAND + 1]  # one more: it stays recognizable as too long
        return ended
